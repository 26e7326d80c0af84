"""Every bound of a search for a stop, on both of its sides."""

from dataclasses import replace
from math import nan

import pytest

from tests.support.endstop_parameters import SEARCH, TICK
from twind.motion.endstop_search import (
    EndstopSearch,
    HomingParameters,
    HomingPhase,
    HomingSample,
    StandstillCheck,
)
from twind.robot.finding import Finding, ReasonCode

PUSH = 0.85 * SEARCH.cap


def course(start: float = 2900.0, search: HomingParameters = SEARCH) -> EndstopSearch:
    return EndstopSearch(search, start, 0.0)


def fed(made: EndstopSearch, looks: list[tuple[int, float]], begin: float = 0.0) -> float:
    """One look (count, effort) a tick; the time."""
    now = begin
    for count, effort in looks:
        now = round(now + TICK, 9)
        made.step(HomingSample(now, count, effort), now)
    return now


def code(made: EndstopSearch) -> ReasonCode | None:
    return None if made.failed is None else made.failed.code


# ------------------------------------------------------------------------------- before it begins


@pytest.mark.parametrize(("last", "agree"), [(3, True), (4, False), (-3, True), (-4, False)])
def test_ten_readings_agree_within_three_counts(last: int, agree: bool) -> None:
    quiet = StandstillCheck(0.0)
    now = 0.0
    for count in [0] * 8 + [last]:
        now += TICK
        assert quiet.step(HomingSample(now, count, 0.0), now) is False
        assert quiet.step(HomingSample(now, count, 0.0), now) is False, "one reading counted twice"
    now += TICK
    assert quiet.step(HomingSample(now, 0, 0.0), now) is agree


@pytest.mark.parametrize(("age", "agree"), [(0.0299, True), (0.0301, False)])
def test_and_the_last_of_them_is_fresh(age: float, agree: bool) -> None:
    quiet = StandstillCheck(0.0)
    for tick in range(10):
        answer = quiet.step(HomingSample(tick * TICK, 0, 0.0), tick * TICK + age)
    assert answer is agree


def test_the_standstill_check_waits_three_seconds_and_reports_the_spread() -> None:
    quiet = StandstillCheck(0.0)
    for tick in range(300):
        now = tick * TICK
        assert quiet.step(HomingSample(now, 7 * (tick % 2), 0.0), now) is False
    answer = quiet.step(HomingSample(3.0, 7, 0.0), 3.0)
    assert isinstance(answer, Finding) and answer.code is ReasonCode.STOP_NOT_FOUND
    assert (answer.value, answer.bound) == (7.0, 3.0)


# ------------------------------------------------------------------------------- a stop


@pytest.mark.parametrize(
    ("effort", "flicker", "found"),
    [(PUSH, 2, True), (-PUSH, 2, True), (PUSH - 0.1, 0, False), (PUSH, 3, False)],
)
def test_a_stop_is_the_cap_and_no_motion(effort: float, flicker: int, found: bool) -> None:
    made = course()
    fed(made, [(2900 + flicker * (tick % 2), effort) for tick in range(40)])
    assert (made.phase is HomingPhase.BACKING) is found


def test_for_so_long_and_no_shorter() -> None:
    made = course()
    now = fed(made, [(2900, PUSH)] * 15)  # 0.14 s between the first and the last
    assert made.captures == []
    fed(made, [(2900, PUSH)], now)
    assert made.captures == [2900.0]


def test_a_reading_below_the_cap_restarts_the_capture() -> None:
    made = course()
    now = fed(made, [(2900, PUSH)] * 12 + [(2900, 0.0)] + [(2900, PUSH)] * 15)
    assert made.captures == []
    fed(made, [(2900, PUSH)] * 2, now)
    assert made.captures == [2900.0]


def test_readings_too_few_are_none() -> None:
    made = course()
    for tick in range(1, 5):
        made.step(HomingSample(tick * 0.05, 2900, PUSH), tick * 0.05)
    assert made.captures == []
    made.step(HomingSample(0.25, 2900, PUSH), 0.25)
    assert made.captures == [], "four of the last 0.15 s"


# ------------------------------------------------------------------------------- what ends it


@pytest.mark.parametrize(
    ("efforts", "ended"),
    [
        ([156.0] * 3, True),
        ([-156.0] * 3, True),
        ([155.0] * 10, False),
        ([156.0] * 2, False),
        ([156.0, 156.0, 0.0] * 3, False),
    ],
)
def test_three_readings_in_a_row_over_the_cap(efforts: list[float], ended: bool) -> None:
    made = course()
    fed(made, [(2900, effort) for effort in efforts])
    assert code(made) is (ReasonCode.OVERCURRENT if ended else None)
    if made.failed is not None:
        assert (made.failed.value, made.failed.bound) == (156.0, 100.0)


@pytest.mark.parametrize("way", [1, -1])
def test_astray_is_so_far_ahead_of_its_goal(way: int) -> None:
    search = replace(SEARCH, way=way, astray=50.0, speed=1e-6)
    for ahead, ended in ((50, None), (51, ReasonCode.STOP_NOT_FOUND)):
        made = course(2900.0, search)
        fed(made, [(2900 + way * ahead, 0.0)])
        assert code(made) is ended
    assert made.failed is not None and made.failed.bound == 50.0
    assert made.failed.value == pytest.approx(51.0)


@pytest.mark.parametrize("way", [1, -1])
def test_or_so_far_back_from_where_it_was(way: int) -> None:
    search = replace(SEARCH, way=way, astray=50.0, speed=1e-6)
    for back, ended in ((50, None), (51, ReasonCode.STOP_NOT_FOUND)):
        made = course(2900.0, search)
        fed(made, [(2900, 0.0), (2900 - way * back, 0.0)])
        assert code(made) is ended
    assert made.failed is not None and made.failed.bound == 50.0
    assert made.failed.value == pytest.approx(51.0)


@pytest.mark.parametrize(
    ("age", "goes_on", "ended"),
    [
        (0.0299, True, None),
        (0.0301, False, None),
        (0.0999, False, None),
        (0.1001, False, ReasonCode.STATE_STALE),
    ],
)
def test_old_readings_stop_the_goals_and_older_ones_end_it(
    age: float, goes_on: bool, ended: ReasonCode | None
) -> None:
    made = course()
    fed(made, [(2900, 0.0)] * 20)
    before = made.goal
    made.step(HomingSample(0.2 + TICK - age, 2900, 0.0), 0.2 + TICK)
    assert (made.goal != before) is goes_on
    assert code(made) is ended
    if made.failed is not None:
        assert made.failed.value == pytest.approx(age)


@pytest.mark.parametrize("gap", [0.0, 0.1, 0.1001, 10.0, -0.01, nan])
def test_steps_are_no_further_apart_than_this(gap: float) -> None:
    made = EndstopSearch(SEARCH, 2900.0, 0.0)
    goal = made.goal
    stepped = made.step(HomingSample(gap, 2900, 0.0), gap)
    assert code(made) is (None if 0.0 <= gap <= 0.1 else ReasonCode.TIME_GAP)
    assert code(made) is None or stepped == goal


def test_a_goal_is_never_further_ahead_than_its_lead() -> None:
    made = course(2900.0, replace(SEARCH, lead=20.0))
    now = fed(made, [(2900, 10.0)] * 40)
    assert made.goal == pytest.approx(2920.0)
    reached = 0.16  # s to be so far ahead, at its speed
    assert code(made) is None
    while made.failed is None:
        now = fed(made, [(2900, 10.0)], now)
    assert "held back" in made.failed.message and now - reached == pytest.approx(1.0, abs=0.04)
    assert made.failed.value == 10.0 and made.failed.bound == pytest.approx(PUSH)
