"""The MuJoCo twin: mirror and simulation of the robot, and the muscles of virtual servos.

Only this package (and `twind.learn`) imports MuJoCo, so here its rendering is disabled. Where all of MuJoCo
is installed, for the viewer, it would otherwise load GLFW or GL into the daemon. A program that draws sets
MUJOCO_GL before.
"""

import os

os.environ.setdefault("MUJOCO_GL", "disable")  # read when MuJoCo is imported, never after
