"""Range of joints that several actuators turn together. Pure: arrays in, arrays out.

Limits are a box of joint angles, counts are a box of actuator angles, and a transmission distorts the one
box. The joints' box is kept only if the whole of it lies within the actuators' box.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twind.config.robot_spec import JointSpec
from twind.robot.arrays import Floats
from twind.robot.transmission import Transmission, fair, forth, span

TAKEN_IN = 0.01  # rad that limits may be reduced to end where the actuators do; more is refused
HALVINGS = 10  # of the interval between limits that fit and limits that do not: 60 µrad are left


@dataclass(frozen=True, slots=True)
class JointBox:
    """Places of the joints of one transmission. Arrays are (k,), rad."""

    lower: Floats  # what the gate accepts
    upper: Floats
    hard_lower: Floats
    hard_upper: Floats


@dataclass(frozen=True, slots=True)
class ActuatorExcess:
    """Range that the limits demand of an actuator, beyond what it may do. `place`: its index, 0 to k - 1."""

    place: int
    least: float  # rad
    most: float  # rad


def box(
    law: Transmission,
    limits: tuple[Floats, Floats],
    ranges: tuple[Floats, Floats],
    allowed: tuple[Floats, Floats],
    beyond: float,
) -> JointBox | ActuatorExcess:
    """Return the joints' `limits` with `beyond` rad around them, or less where actuators end before.

    All arguments are lower and upper ends (k,), rad; `ranges` are the model's, `allowed` the actuators'.
    The result is an excess if even slightly narrower limits lead an actuator beyond its range.
    """

    def widened(by: float) -> tuple[Floats, Floats]:
        return np.maximum(limits[0] - by, ranges[0]), np.minimum(limits[1] + by, ranges[1])

    def outside(by: float) -> Floats:
        low, high = span(law, *widened(by))
        return np.asarray(~((low >= allowed[0]) & (high <= allowed[1])))  # NaN is outside

    fits = -TAKEN_IN
    fails = beyond
    if not outside(beyond).any():
        fits = beyond
    elif not outside(0.0).any():
        fits = 0.0
    elif outside(fits).any():
        place = int(np.argmax(outside(fits)))
        low, high = span(law, *widened(0.0))
        return ActuatorExcess(place, float(low[place]), float(high[place]))
    else:
        fails = 0.0
    for _ in range(HALVINGS if fits < beyond else 0):
        middle = 0.5 * (fits + fails)
        fits, fails = (middle, fails) if not outside(middle).any() else (fits, middle)
    return JointBox(*widened(min(fits, 0.0)), *widened(fits))


def strength(law: Transmission, seats: Sequence[JointSpec]) -> Floats:
    """Return the torque (k,), N·m, that all joints can have at once within the actuators' limits.

    NaN unknown.
    """
    bound = np.array([joint.ratio * joint.type.effort_limit_nm for joint in seats])
    return fair(forth(law).T, bound, np.full(len(seats), np.inf))
