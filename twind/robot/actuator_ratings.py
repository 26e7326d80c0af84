"""Ratings of each joint's actuator: voltage, heat, current. `Limits` states what the joint may do."""

from dataclasses import dataclass
from math import inf

import numpy as np

from twind.robot.arrays import Bools, Floats, frozen


@dataclass(frozen=True, slots=True)
class ActuatorRatings:
    """Bounds per joint, (n,) each. Where nothing is known of a model they are infinite: never reached."""

    low_warn: Floats  # V: told at and below
    low_settle: Floats  # V: settled at and below; below it no motion begins and nobody arms
    low_fault: Floats  # V: a fault at and below
    high_warn: Floats  # V: told above
    warm: Floats  # °C: told from here on
    hot: Floats  # °C: slower from here on; above it no motion begins and nobody arms
    shut: Floats  # °C: settled from here on
    cool: Floats  # °C: once settled for heat, nobody arms before it is below this
    continuous: Floats  # of the current limit, 0 to 1: what it bears for ever (I²t)
    leg: Bools  # carries the robot: one that lost its torque lets a free-standing robot fall

    @classmethod
    def unknown(cls, count: int) -> "ActuatorRatings":
        """Build the ratings of `count` joints whose models are unknown: no bound is ever reached, and each
        may be a leg."""
        never = frozen([-inf] * count)
        above = frozen([inf] * count)
        always = np.ones(count, np.bool_)
        return cls(never, never, never, above, above, above, above, above, frozen([1.0] * count), always)
