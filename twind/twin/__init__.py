"""The MuJoCo twin: mirror of the measured robot, simulation of the commanded one, muscles.

Nobody else imports MuJoCo (beside what learns), so here it is said that no picture is wanted of it: where
all of MuJoCo is installed, for the viewer, it would load GLFW or GL into the daemon. Who draws sets
MUJOCO_GL before.
"""

import os

os.environ.setdefault("MUJOCO_GL", "disable")  # read when MuJoCo is imported, never after
