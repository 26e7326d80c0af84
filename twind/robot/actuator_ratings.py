"""Ratings of each joint's actuator: voltage, heat, current. `JointLimits` states what the joint may do."""

from dataclasses import dataclass
from math import inf, nan

import numpy as np

from twind.robot.arrays import Bools, Floats, frozen


@dataclass(frozen=True, slots=True)
class ActuatorRatings:
    """Bounds per joint, (n,) each. For unknown models they are infinite: never reached."""

    low_warn: Floats  # V: reported at and below
    low_settle: Floats  # V: settled at and below; below it motion and arming are refused
    low_fault: Floats  # V: a fault at and below
    high_warn: Floats  # V: reported above
    warm: Floats  # °C: reported from here on
    hot: Floats  # °C: slower from here on; above it motion and arming are refused
    shut: Floats  # °C: settled from here on
    cool: Floats  # °C: after settling for heat, arming is refused until the temperature is below this
    continuous: Floats  # share of the current limit, 0 to 1, of a continuous load (I²t)
    lead: Floats  # rad that a goal may lead its joint, beyond the sag of its load; inf: it has a watchdog
    stiffness: Floats  # N·m/rad at the joint, identified or by its gains; NaN: unknown, or none
    lag: Floats  # s that a moving joint is behind its goal, by its gains; NaN unknown
    follow: Floats  # rad that the owner lets it be behind its goal (FOLLOW_ERR); NaN: not stated
    follow_for: Floats  # s, how long; NaN: not stated
    leg: Bools  # carries the robot: without its torque a free-standing robot falls

    @classmethod
    def unknown(cls, count: int) -> "ActuatorRatings":
        """Build the ratings of `count` joints of unknown models.

        No bound is ever reached, and each joint may be a leg.
        """
        never = frozen([-inf] * count)
        above = frozen([inf] * count)
        always = np.ones(count, np.bool_)
        full = frozen([1.0] * count)
        unknown = frozen([nan] * count)
        following = (unknown, unknown, unknown, unknown)
        return cls(never, never, never, above, above, above, above, above, full, above, *following, always)
