"""Limits of each joint: the tightest of robot file, calibration, device and model."""

from dataclasses import dataclass

from twind.robot.arrays import Floats


@dataclass(frozen=True, slots=True)
class JointLimits:
    """Bounds per joint, (n,) each. `lower..upper` is what the gate accepts, inclusive."""

    lower: Floats  # rad
    upper: Floats  # rad
    hard_lower: Floats  # rad, 0.05 beyond `lower`, never past the measured travel
    hard_upper: Floats  # rad
    velocity: Floats  # rad/s, > 0
    acceleration: Floats  # rad/s², > 0
    effort: Floats  # N·m, > 0, NaN unknown

    def nearest(self, joint: int, position: float) -> float:
        """Return the position limit (rad) that is nearest to `position`, for a finding's bound."""
        lower = float(self.lower[joint])
        upper = float(self.upper[joint])
        return upper if abs(position - upper) <= abs(position - lower) else lower
