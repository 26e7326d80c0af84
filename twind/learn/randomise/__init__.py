"""Domain randomisation: values drawn anew at each reset, so that a policy works in simulation and on a robot.

`ranges.yaml` has every range, `ranges` reads it, `draw` draws. `physics` applies a draw to a model or to a
simulation of a batch. `pushes` and `noise` work while an episode runs, `delays` fills histories.
"""
