"""Way to a first point at t = 0 that the reference has not reached: judged, then followed. Pure."""

from dataclasses import replace
from math import ceil

import numpy as np

from twind.robot.joint_limits import JointLimits
from twind.robot.trajectory import Reference, Trajectory

JUMP = 1e-9  # rad: a smaller jump of a first point at t = 0 is rounding
SHARE = 0.5  # of the velocity limit for the way to a first point at t = 0


def led_in(path: Trajectory, before: Reference, limits: JointLimits, period: float) -> Trajectory:
    """Return the path; one that would jump at t = 0 begins later, by the duration of a smooth way to it."""
    if path.time[0] > 0.0:
        return path
    columns = path.commanded
    jump = np.where(columns, np.abs(path.position[0] - before.position), 0.0)
    if not (jump > JUMP).any():
        return path
    speed = np.abs(before.velocity)
    if path.velocity is not None:
        speed = np.maximum(speed, np.abs(path.velocity[0]))
    speed = np.where(columns, speed, 0.0)
    room = np.maximum(np.minimum(SHARE * limits.velocity, limits.velocity - speed), 0.05 * limits.velocity)
    wanted = [
        period,
        float((1.875 * jump / room).max()),
        float(np.sqrt(6.0 * jump / (0.4 * limits.acceleration)).max()),
        float((10.0 * speed / limits.acceleration).max()),
    ]
    lead = ceil(max(wanted) / period - 1e-9) * period
    return replace(path, time=path.time + lead)
