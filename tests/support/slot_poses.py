"""Poses of joints from the angles of their actuators."""

from collections.abc import Mapping

import numpy as np

from twind.config.robot_spec import RobotFile


def joint_angles(robot: RobotFile, slots: Mapping[str, float]) -> dict[str, float]:
    """Return the pose (rad) of the joints whose slots stand at these angles, by joint; NaN: unknown."""
    found = dict(slots)
    for each in robot.transmissions:
        angles = each.law.forward(np.array([slots[name] for name in each.joints]))
        found |= zip(each.joints, angles.tolist(), strict=True)
    return found
