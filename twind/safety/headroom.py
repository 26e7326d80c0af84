"""Headroom before motion or torque: temperature and supply of the joints (THERMAL_HEADROOM). Pure."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isnan

import numpy as np

from twind.robot.actuator_ratings import ActuatorRatings
from twind.robot.arrays import Bools, Floats, Ints, spread_over_groups
from twind.robot.finding import Finding, ReasonCode

UNREAD = "not read yet; retry in half a second"


def is_unread(finding: Finding) -> bool:
    """Check that a finding of `headroom` states no value that was read lately."""
    return finding.value is None or isnan(finding.value)


@dataclass(frozen=True, slots=True)
class JointCondition:
    """Last temperature and supply readings with the ratings of the actuators. Arrays are (n,)."""

    temperature: Floats  # °C, NaN never read
    voltage: Floats  # V, NaN never read
    age: Floats  # s since both were read; inf never
    ratings: ActuatorRatings
    together: Sequence[
        Ints
    ] = ()  # indices of joints that the same motors turn: none moves without all of them


def headroom(condition: JointCondition, chosen: Bools, oldest: float) -> list[Finding]:
    """Check THERMAL_HEADROOM and VOLTAGE_LOW of the motors of `chosen` (n,).

    A reading older than `oldest` (s), or none, refuses. Where a model's bounds are unknown (infinite) nothing
    is judged: its servos may have no such register, and must not be refused for ever.
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
            else:  # that value may be good, and is not the reason
                text = f"not read lately: {last:.3g} {unit} was {age:.2g} s ago; retry in half a second"
                found.append(Finding(code, int(joint), message=text))
    return found
