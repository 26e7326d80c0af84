"""End of a search for a stop: exact to the count, the reading and the tick."""

from dataclasses import replace

import pytest

from tests.support.endstop_parameters import SEARCH, TICK
from twind.motion.endstop_search import (
    MARGIN,
    USUAL_SHARE,
    USUAL_SPEED,
    USUAL_TIMES,
    EndstopSearch,
    HomingPhase,
    HomingSample,
    StandstillCheck,
)
from twind.robot.finding import Finding, ReasonCode

PUSH = SEARCH.cap
ROUND = replace(SEARCH, margin=100.0, back=20.0, speed=1000.0, lead=200.0, astray=60.0)  # in round numbers


def course(start: float = 2900.0, begin: float = 0.0, **other: float) -> EndstopSearch:
    return EndstopSearch(replace(ROUND, **other), start, begin)


def stand(made: EndstopSearch, count: int, effort: float, until: float, now: float) -> float:
    """The joint stands there, and loads its motor so; a reading each tick. The time."""
    while now < until - 1e-9:
        now = round(now + TICK, 9)
        made.step(HomingSample(now, count, effort), now)
    return now


def captured(made: EndstopSearch, count: int, now: float) -> float:
    """It follows its goal until it has met its stop there."""
    many = len(made.captures)
    for _ in range(100):
        met = (made.goal - count) * made.search.way >= 0.0
        now = stand(made, count if met else round(made.goal), PUSH if met else 0.0, now + TICK, now)
        if len(made.captures) > many:
            return now
    raise AssertionError(made.failed)


def back(made: EndstopSearch, now: float) -> float:
    """The joint follows all the way, until the next approach begins or all is found."""
    while made.phase is HomingPhase.BACKING:
        now = round(now + TICK, 9)
        made.step(HomingSample(now, round(made.goal), 0.0), now)
    return now


def over(finding: Finding | None) -> tuple[ReasonCode, float, float] | None:
    return None if finding is None else (finding.code, finding.value, finding.bound)


# ------------------------------------------------------------------------------- what is usual


def test_the_default_search_is_weak_slow_and_repeated_three_times() -> None:
    assert (USUAL_SHARE, USUAL_SPEED, USUAL_TIMES, MARGIN) == (0.12, 0.2, 3, 0.2)


# ------------------------------------------------------------------------------- before it begins


def test_readings_of_three_hundredths_of_a_second_ago_are_fresh() -> None:
    quiet = StandstillCheck(-1.0)
    for tick in range(-9, 0):
        assert quiet.step(HomingSample(tick * TICK, 500, 0.0), tick * TICK) is False
    assert quiet.step(HomingSample(0.0, 500, 0.0), 0.03) is True


def test_the_spread_of_the_readings_is_reported_at_any_position() -> None:
    quiet = StandstillCheck(0.0)
    for tick in range(300):
        answer = quiet.step(HomingSample(tick * TICK, 500 + 7 * (tick % 2), 0.0), tick * TICK)
    answer = quiet.step(HomingSample(3.0, 500, 0.0), 3.0)
    assert isinstance(answer, Finding) and answer.value == 7.0


# ------------------------------------------------------------------------------- progress


@pytest.mark.parametrize("way", [1, -1])
def test_progress_is_the_share_of_the_way_and_then_of_the_captures(way: int) -> None:
    made = course(3000.0 - way * 100.0, way=way)  # 200 to the farthest goal
    assert made.progress == 0.0
    now = stand(made, 3000 - way * 100, 0.0, 0.05, 0.0)
    assert made.progress == pytest.approx(50.0 / 200.0 / 3.0)
    captured(made, 3000 - way * 100, now)
    assert made.progress == pytest.approx(1.0 / 3.0)


def test_a_way_of_less_than_a_count_is_one() -> None:
    assert course(3099.5).progress == pytest.approx(0.5 / 3.0)


# ------------------------------------------------------------------------------- the approach


def test_five_readings_in_that_time_are_enough() -> None:
    made = course()
    for tick in range(5):
        assert made.captures == []
        at = tick * 0.0375
        made.step(HomingSample(at, 2900, PUSH), at)
    assert made.captures == [2900.0]


def test_a_blocked_joint_that_moves_on_gets_its_full_time_again() -> None:
    made = course(lead=20.0)
    now = stand(made, 2900, 10.0, 0.9, 0.0)
    now = stand(made, 2910, 10.0, now + TICK, now)  # it gave way once
    now = stand(made, 2910, 10.0, now + 0.9, now)
    assert made.failed is None
    stand(made, 2910, 10.0, now + 0.2, now)
    assert made.failed is not None and "held back" in made.failed.message


@pytest.mark.parametrize("way", [1, -1])
def test_a_missing_endstop_is_reported_one_second_after_the_end_of_the_range(way: int) -> None:
    """Exactly: the steps are of 1/64 s."""
    end = 3000 + way * 100
    made = course(end - way * 1.0, way=way, speed=1.0)  # a count, at a count a second
    for step in range(1, 130):  # its goal is there with step 64, and seen to be with step 65
        made.step(HomingSample(step / 64, end, 0.0), step / 64)
    assert made.goal == end and made.failed is None
    made.step(HomingSample(130 / 64, end, 0.0), 130 / 64)
    assert over(made.failed) == (ReasonCode.STOP_NOT_FOUND, 100.0, 100.0)


# ------------------------------------------------------------------------------- captures


@pytest.mark.parametrize("way", [1, -1])
def test_a_capture_is_no_further_from_where_it_should_be_than_the_margin(way: int) -> None:
    for off, ended in ((100, None), (101, (ReasonCode.STOP_NOT_FOUND, 101.0, 100.0))):
        made = course(3000.0 - way * off, way=way)
        captured(made, 3000 - way * off, 0.0)
        assert over(made.failed) == ended


@pytest.mark.parametrize(("second", "ended"), [(2905, None), (2906, (ReasonCode.STOP_NOT_FOUND, 6.0, 5.0))])
def test_captures_are_no_further_apart_than_five_counts(second: int, ended: object) -> None:
    made = course()
    now = back(made, captured(made, 2900, 0.0))
    captured(made, second, now)
    assert over(made.failed) == ended


# ------------------------------------------------------------------------------- the way back


@pytest.mark.parametrize("way", [1, -1])
def test_the_search_backs_off_from_the_last_capture_by_the_exact_count(way: int) -> None:
    made = course(3000.0 - way * 100, way=way, astray=10.0, back=20.5)  # further than astray
    begin = captured(made, 3000 - way * 100, 0.0)
    now = back(made, begin)
    assert now - begin > 0.3
    assert made.goal == 3000 - way * 100 - way * 20.5
    back(made, captured(made, 3000 - way * 97, now))
    assert made.goal == 3000 - way * 97 - way * 20.5
    assert made.failed is None


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize(("turn", "cause"), [(4096.0, "its turn stays unknown"), (0.0, "it runs away")])
def test_a_joint_that_does_not_leave_its_stop_with_its_goal_ends_the_search(
    way: int, turn: float, cause: str
) -> None:
    made = course(2900.0 if way > 0 else 3100.0, way=way, times=1, turn=turn, away=200.0)
    assert made.turns_off == 0.0
    now = captured(made, 3000, 0.0)
    while (3000 - made.goal) * way < 60.0:  # as far as it may be behind
        now = stand(made, 3000, PUSH, now + TICK, now)
        assert made.failed is None
    stand(made, 3000, PUSH, now + 2 * TICK, now)
    assert over(made.failed) == (ReasonCode.STOP_NOT_FOUND, 70.0, 60.0)
    assert made.failed is not None and cause in made.failed.message


def on_its_way_back() -> EndstopSearch:
    """Its goal comes to its end, count 2880, with the step at time 0."""
    made = course(begin=-0.2, lead=0.5)
    stand(made, 2900, PUSH, -0.04, -0.2)
    assert made.captures == [2900.0]
    for at in (-0.03, -0.02, -0.01, 0.0):
        made.step(HomingSample(at, 2880, 0.0), at)
        assert made.goal == max(2880.0, 2890.5 - 1000.0 * (at + 0.03)), "at its own speed, and no further"
    return made


def test_a_joint_is_given_three_tenths_of_a_second_to_follow() -> None:
    made = on_its_way_back()
    for at in (0.1, 0.2, 0.2999):
        made.step(HomingSample(at, 2880, 0.0), at)
        assert made.phase is HomingPhase.BACKING
    made = on_its_way_back()
    for at in (0.1, 0.2, 0.3):
        made.step(HomingSample(at, 2880, 0.0), at)
    assert made.phase is HomingPhase.APPROACHING


@pytest.mark.parametrize(
    ("off", "ended"),
    [
        (10, None),
        (-10, None),
        (11, (ReasonCode.STOP_NOT_FOUND, 11.0, 10.0)),
        (-11, (ReasonCode.STOP_NOT_FOUND, 11.0, 10.0)),
    ],
)
def test_a_return_of_less_than_half_the_distance_ends_the_search(off: int, ended: object) -> None:
    made = on_its_way_back()
    for at in (0.1, 0.2, 0.3):
        made.step(HomingSample(at, 2880 + off, 0.0), at)
    assert over(made.failed) == ended


def test_current_drawn_during_the_return_is_no_capture() -> None:
    made = on_its_way_back()
    now = stand(made, 2880, PUSH, 0.3, 0.0)
    assert made.phase is HomingPhase.APPROACHING
    now = stand(made, 2880, PUSH, now + 0.15, now)
    assert len(made.captures) == 1
    stand(made, 2880, PUSH, now + TICK, now)
    assert len(made.captures) == 2


def test_once_it_is_found_nothing_moves_it_or_makes_it_fail() -> None:
    made = course(times=2)
    now = back(made, captured(made, 2900, 0.0))
    now = back(made, captured(made, 2900, now))
    assert made.phase is HomingPhase.FOUND
    goal = made.goal
    for later, count in ((TICK, 2880), (2 * TICK, 5000), (3.0, 5000)):
        assert made.step(HomingSample(now + later, count, PUSH), now + later) == goal
    assert (made.phase, made.failed) == (HomingPhase.FOUND, None)


# ------------------------------------------------------------------------------- what ends it


@pytest.mark.parametrize(
    ("efforts", "ended"), [([0.0] + [156.0] * 2, False), ([0.0] + [156.0] * 3, True), ([155.2] * 3, True)]
)
def test_over_the_cap_is_counted_from_the_first_that_is(efforts: list[float], ended: bool) -> None:
    made = course()
    for tick, effort in enumerate(efforts, 1):
        made.step(HomingSample(tick * TICK, 2900, effort), tick * TICK)
    assert (made.failed is not None) is ended


def test_a_reading_that_is_seen_again_is_not_counted_again() -> None:
    made = course()
    for tick, (at, effort) in enumerate([(0.01, 0.0), (0.02, 156.0), (0.02, 156.0), (0.02, 156.0)], 1):
        made.step(HomingSample(at, 2900, effort), tick * TICK)
    assert made.failed is None


def test_readings_of_a_tenth_of_a_second_ago_are_not_lost_and_of_three_hundredths_are_fresh() -> None:
    made = course()
    made.step(HomingSample(0.0, 2900, 0.0), 0.03)
    assert made.goal == 2930.0
    made.step(HomingSample(0.0, 2900, 0.0), 0.1)
    assert (made.goal, made.failed) == (2930.0, None)


@pytest.mark.parametrize("begin", [0.0, 3.0])
def test_the_search_ends_after_twice_its_nominal_time_plus_five_seconds(begin: float) -> None:
    """100 counts to the end at 1000 counts/s; thrice 120 there and back, 0.15 s pressed, 0.3 s still."""
    made = course(3000.0, begin)
    bound = 2.0 * (0.1 + 3 * (2.0 * 0.12 + 0.15 + 0.3)) + 5.0
    now = waiting(made, begin, begin + bound)
    assert made.failed is None
    made.step(HomingSample(now, 3000, 0.0), now + TICK)
    told = made.failed
    assert told is not None and told.code is ReasonCode.STOP_NOT_FOUND
    assert told.bound == pytest.approx(bound, abs=1e-9)
    assert told.value == pytest.approx(bound, abs=1.01 * TICK) and told.value > told.bound
    made = course(3000.0)
    now = waiting(made, 0.0, told.bound)
    made.step(HomingSample(now, 3000, 0.0), told.bound)
    assert made.failed is None, "not before that time is over"


def waiting(made: EndstopSearch, now: float, end: float) -> float:
    """The last step before the end; of readings so old no goal advances."""
    while now + TICK < end:
        now += TICK
        made.step(HomingSample(now - 0.05, 3000, 0.0), now)
    return now
