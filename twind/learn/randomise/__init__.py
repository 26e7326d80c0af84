"""What is drawn anew at each reset so that a policy survives the difference between simulation and robot.

`ranges.yaml` has every range, `ranges` reads it, `draw` draws, `physics` applies a draw to a model or to a
simulation of a batch, `pushes` and `noise` work while an episode runs, `delays` fills histories.
"""
