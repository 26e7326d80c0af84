"""Travels that the robot file accepts are those whose turn can be determined somewhere after a power-up."""

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from twind.config.calibration_file import turn_band
from twind.config.counts import tick_range
from twind.config.robot_file import load_robot
from twind.config.robot_spec import JointSpec
from twind.config.travel import (
    has_middle,
    is_long,
    longest_travel,
    most_turns,
    slack,
    sweep_range,
    travel_refusal,
    zero_range,
)
from twind.robot.measured_travel import MeasuredTravel
from twind.safety.multiturn import chosen, unfit

JOINT = load_robot("h24").joints[0]
TURN = 4096
MANY = 1_048_575


def waist(
    ratio: float, mode: str = "extended_position", lower: float = -1.57, upper: float = 1.57
) -> JointSpec:
    return replace(JOINT, ratio=ratio, mode=mode, lower=lower, upper=upper, sign=1)


def test_gears_of_a_waist_by_mode() -> None:
    for ratio, long in ((1.0, False), (2.0, True), (2.98, True), (10.0, True)):
        assert travel_refusal(waist(ratio)) is None
        assert is_long(waist(ratio)) == long
    assert travel_refusal(waist(1.0, "position")) is None
    assert "does not fit one turn of 4096" in (travel_refusal(waist(2.0, "position")) or "")
    assert [has_middle(waist(ratio)) for ratio in (2.5, 2.98)] == [True, False]
    assert "its goals reach on every turn" in (travel_refusal(waist(600.0)) or "")
    assert most_turns(JOINT.type, "position") == 1.0
    assert longest_travel(waist(1.0, "position")) == TURN - 1


@given(st.floats(0.2, 20.0), st.floats(-3.0, 0.5), st.floats(0.1, 4.0), st.integers(-3, 3))
def test_every_accepted_travel_has_a_zero_and_is_determined_in_its_middle(
    ratio: float, lower: float, span: float, off: int
) -> None:
    joint = waist(ratio, lower=lower, upper=lower + span)
    assert travel_refusal(joint) is None
    zeros = zero_range(joint)
    assert zeros[0] <= zeros[1]
    for zero in zeros:
        first, last = tick_range(joint, zero, *sweep_range(joint))
        middle = (first + last) // 2
        assert 0 <= middle < TURN, "a servo that starts there reads a count of the calibration"
        of = travel(first, last, slack(joint))
        raw = np.array([middle + off * TURN])
        shift = chosen(raw, of)
        assert (raw + shift)[0] == middle
        assert is_long(joint) <= bool(of.ambiguous[0])
        if is_long(joint):
            assert (not unfit(raw, shift, of, np.array([False]))) == has_middle(joint)


def travel(first: int, last: int, slack: int) -> MeasuredTravel:
    """Make the travel of one joint in a mode of several turns."""
    numbers = {
        "whole": TURN,
        "band": turn_band((first, last), TURN)[0],
        "first": first,
        "last": last,
        "slack": slack,
        "least": -MANY,
        "most": MANY,
        "lower": first,
        "upper": last,
        "begin": 0,
    }
    arrays = {name: np.array([number]) for name, number in numbers.items()}
    return MeasuredTravel(known=np.array([True]), falls=np.array([False]), **arrays)
