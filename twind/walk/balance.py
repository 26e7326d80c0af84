"""Balance of a walking robot by its IMU: ankles push against a tilt of the torso. Pure."""

import math
from dataclasses import dataclass

from twind.robot.arrays import Floats


@dataclass(frozen=True, slots=True)
class BalanceGains:
    """Ankle angle per tilt and per its rate: rad/rad and rad/(rad/s)."""

    pitch: float = 0.35
    pitch_rate: float = 0.06
    roll: float = 0.35
    roll_rate: float = 0.05


def tilt_of(quaternion: Floats) -> tuple[float, float]:
    """Return roll and pitch, rad, of an orientation w x y z (4,): both 0 where the torso is upright."""
    w, x, y, z = quaternion.tolist()
    forward = 2.0 * (w * y - x * z)  # x of the world's up, in the axes of the torso, reversed
    left = 2.0 * (w * x + y * z)
    up = 1.0 - 2.0 * (x * x + y * y)
    return math.atan2(left, up), math.atan2(
        forward, math.hypot(left, up) if up >= 0.0 else -math.hypot(left, up)
    )


def ankle_correction(gains: BalanceGains, quaternion: Floats, gyro: Floats) -> tuple[float, float]:
    """Return what is added to ankle pitch and ankle roll, rad. `gyro` (3,): rad/s, axes of the torso."""
    roll, pitch = tilt_of(quaternion)
    return (
        gains.pitch * pitch + gains.pitch_rate * float(gyro[1]),
        gains.roll * roll + gains.roll_rate * float(gyro[0]),
    )
