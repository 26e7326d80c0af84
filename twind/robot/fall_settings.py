"""Settings of fall detection, as the robot file has them. Pure data."""

from dataclasses import dataclass
from enum import StrEnum


class FallReaction(StrEnum):
    """Reaction of the daemon to a fall."""

    HOLD = "hold"  # brake, then keep the goals
    SOFT = "soft"  # soft servos that yield, then torque off
    FOLD = "fold"  # to a pose as fast as the limits allow, then torque off


class FallState(StrEnum):
    """State of balance that fall detection reports."""

    UNKNOWN = "unknown"  # no recent reading of the IMU
    UPRIGHT = "upright"
    FALLING = "falling"
    FALLEN = "fallen"  # it came to rest, and does not stand


@dataclass(frozen=True, slots=True)
class FallSettings:
    """Reaction and thresholds."""

    reaction: FallReaction
    pose: str = "fold"  # of the robot file, for the reaction fold
    outside: float = 0.03  # m from the edge of the feet to the capture point beyond it ...
    seconds: float = 0.03  # s ... for so long
    tilt: float = 0.8  # rad of the base: a fall, wherever its feet are
    upright: float = 0.3  # rad: a smaller tilt counts as standing again
