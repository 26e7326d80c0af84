"""Counts of an encoder and angles of a joint: the arithmetic of the robot file, written once.

count → minus zero → x 2π / ticks_per_turn → x sign / ratio → slot rad → transmission → joint rad. `ratio` is
actuator turns per turn of what it drives; direction is in `sign` alone. Where no transmission turns a joint,
the angle of its slot is its own.
"""

import math
from collections.abc import Mapping

import numpy as np

from twind.config.actuator_types import TypeSpec
from twind.config.robot_spec import JointSpec, RobotFile


def rad_per_tick(joint: JointSpec) -> float:
    """Angle of the slot of one count, signed: sign / ratio * 2π / ticks_per_turn."""
    return joint.sign / joint.ratio * 2.0 * math.pi / joint.type.ticks_per_turn


def turn_start(kind: TypeSpec, homing_offset: int = 0) -> int:
    """Return the first count of its boot turn, where the encoder wraps: X series 0, PH54-200 -501923."""
    return kind.centre - kind.ticks_per_turn // 2 + (homing_offset if kind.offset_moves_seam else 0)


def angle_of(joint: JointSpec, zero: int, ticks: int) -> float:
    """Angle of the slot (rad) at `ticks`."""
    return (ticks - zero) * rad_per_tick(joint)


def ticks_of(joint: JointSpec, zero: int, angle: float) -> int:
    """The count nearest to `angle` of the slot (rad)."""
    return zero + round(angle / rad_per_tick(joint))


def tick_range(joint: JointSpec, zero: int, lower: float, upper: float) -> tuple[int, int]:
    """The smallest and the largest count whose angle lies in lower..upper (rad), inclusive."""
    ends = sorted((lower / rad_per_tick(joint), upper / rad_per_tick(joint)))
    slack = 1e-9  # counts: an angle that is a count's own lies inside, however it was rounded
    return zero + math.ceil(ends[0] - slack), zero + math.floor(ends[1] + slack)


def slot_angles(robot: RobotFile, pose: Mapping[str, float]) -> dict[str, float]:
    """Return the slot angle of each joint (rad, after sign and ratio) in a pose of all joints.

    NaN: no place of its actuators gives that pose.
    """
    found = dict(pose)
    for each in robot.transmissions:
        angles = each.law.inverse(np.array([pose[name] for name in each.joints]))
        found |= zip(each.joints, angles.tolist(), strict=True)
    return found
