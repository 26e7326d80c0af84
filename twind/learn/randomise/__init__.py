"""Domain randomisation: values drawn anew at each reset, so that a policy works in simulation and on a robot.

`ranges.yaml` has every range, `randomisation_ranges.py` reads it and draws from it.
`physics_randomiser.py` applies a draw to a model or to a simulation of a batch, `episode_start.py` to the
state that an episode begins in. `disturbances.py` works while an episode runs.
"""
