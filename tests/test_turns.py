"""Of a reading and the two a turn beside it exactly one must fit the travel, and that must be the reading."""

from dataclasses import replace
from math import inf, nan, tau

import numpy as np
import pytest
from guard_world import LIMITS, N
from hypothesis import given
from hypothesis import strategies as st

from twind.robot.finding import Code
from twind.safety.turns import TOLERANCE, astray

TURN = np.array([tau, tau, inf])[:N]
LOW, HIGH = -1.0, 1.5
TRAVEL = replace(LIMITS, hard_lower=np.full(N, LOW), hard_upper=np.full(N, HIGH))
JUST = 1e-9


def first(reading: float, limits: object = TRAVEL) -> str:
    """What is said of joint 0; empty: nothing."""
    found = astray(np.array([reading, 0.0, 0.0]), TURN, limits)  # type: ignore[arg-type]
    assert all(each.code is Code.CALIB_MISMATCH and each.joint == 0 for each in found)
    assert len(found) < 2
    return found[0].message if found else ""


@pytest.mark.parametrize("reading", [LOW, HIGH, 0.0, LOW - TOLERANCE + JUST, HIGH + TOLERANCE - JUST])
def test_a_reading_in_the_travel_and_alone_there_is_fine(reading: float) -> None:
    assert first(reading) == ""


@pytest.mark.parametrize(
    ("reading", "words"),
    [
        (LOW - TOLERANCE - JUST, "neither -1.150 rad nor a turn beside it"),
        (HIGH + TOLERANCE + JUST, "neither 1.650 rad nor a turn beside it"),
        (3.0, "zero lost?"),
        (tau, "reads 6.283 rad, a turn off: 0.000 is within its travel -1.150..1.650"),
        (-tau + 1.0, "a turn off: 1.000 is within"),
        (2.0 * tau, "neither 12.566 rad"),
        (nan, "neither nan rad"),
        (inf, "neither inf rad"),
    ],
)
def test_a_reading_that_fits_nowhere_or_a_turn_off_is_said(reading: float, words: str) -> None:
    assert words in first(reading)


def test_a_travel_of_more_than_a_turn_cannot_be_told() -> None:
    wide = replace(TRAVEL, hard_lower=np.full(N, -3.5), hard_upper=np.full(N, 3.5))
    assert "-3.200 and 3.083 rad both fit" in first(-3.2, wide)
    assert first(0.0, wide) == ""


def test_who_tells_its_turn_itself_is_not_judged() -> None:
    assert astray(np.array([0.0, 0.0, 100.0]), TURN, TRAVEL) == []
    assert astray(np.array([0.0, 0.0, nan]), TURN, TRAVEL) == []


def test_a_gear_makes_the_turn_of_the_joint_smaller() -> None:
    found = astray(np.array([tau / 4, 0.0, 0.0]), TURN / 4, replace(TRAVEL, hard_upper=np.full(N, 0.2)))
    assert "a turn off: 0.000" in found[0].message


@given(st.floats(-30.0, 30.0), st.floats(0.1, 7.0), st.floats(-7.0, 7.0), st.floats(0.0, 7.0))
def test_nothing_passes_that_is_outside_or_not_alone(
    reading: float, turn: float, low: float, span: float
) -> None:
    limits = replace(TRAVEL, hard_lower=np.full(N, low), hard_upper=np.full(N, low + span))
    if astray(np.array([reading, 0.0, 0.0]), np.array([turn, inf, inf]), limits) == []:
        least, most = low - TOLERANCE, low + span + TOLERANCE
        assert least <= reading <= most
        assert not least <= reading + turn <= most
        assert not least <= reading - turn <= most
