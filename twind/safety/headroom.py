"""Is there room to begin: temperature and supply of the joints to move or to arm (THERMAL_HEADROOM)? Pure."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twind.robot.actuator_ratings import ActuatorRatings
from twind.robot.arrays import Bools, Floats, Ints, spread_over_groups
from twind.robot.finding import Finding, ReasonCode

UNREAD = "not read yet; ask again in half a second"


@dataclass(frozen=True, slots=True)
class JointCondition:
    """What was read last, beside what each joint bears. Arrays are (n,)."""

    temperature: Floats  # °C, NaN never read
    voltage: Floats  # V, NaN never read
    age: Floats  # s since both were read; inf never
    ratings: ActuatorRatings
    together: Sequence[
        Ints
    ] = ()  # places of joints that motors turn together: none moves without all of them


def headroom(condition: JointCondition, chosen: Bools, oldest: float) -> list[Finding]:
    """Check THERMAL_HEADROOM of the motors of `chosen`. A reading older than `oldest` (s), of another age or
    not there refuses.

    Where nothing is known of a model's bounds (they are infinite) nothing is judged: its servos may have no
    such register, and must not be barred for ever.
    """
    ratings = condition.ratings
    read = (condition.age >= 0.0) & (condition.age <= oldest)
    warm = condition.temperature
    low = condition.voltage
    hot = ~(ratings.hot == np.inf) & ~(read & (warm <= ratings.hot))
    weak = ~(ratings.low_settle == -np.inf) & ~(read & (low > ratings.low_settle))
    found = []
    for code, wrong, value, bound, unit, reason in (
        (ReasonCode.THERMAL_HEADROOM, hot, warm, ratings.hot, "°C", "too hot to begin; let it cool"),
        (
            ReasonCode.VOLTAGE_LOW,
            weak,
            low,
            ratings.low_settle,
            "V",
            "too low to begin; charge it, check the supply",
        ),
    ):
        for joint in np.flatnonzero(spread_over_groups(chosen, condition.together) & wrong):
            last = float(value[joint])
            most = float(bound[joint])
            age = float(condition.age[joint])
            if not (np.isfinite(last) and np.isfinite(age)):
                found.append(Finding(code, int(joint), value=last, bound=most, message=UNREAD))
            elif read[joint]:
                found.append(Finding(code, int(joint), value=last, bound=most, message=f"{unit}: {reason}"))
            else:  # that number may be a good one, and is not the reason
                told = f"not read lately: {last:.3g} {unit} was {age:.2g} s ago; ask again in half a second"
                found.append(Finding(code, int(joint), message=told))
    return found
