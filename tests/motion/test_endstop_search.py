"""The course of finding a stop, against a joint made of a few numbers: where it ends, what loads it."""

from dataclasses import dataclass, replace
from itertools import pairwise
from math import inf, nan

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tests.support.endstop_parameters import RAD, SEARCH, TICK
from tests.support.examples import examples
from twind.motion.endstop_search import (
    SPREAD,
    EndstopSearch,
    HomingParameters,
    HomingPhase,
    HomingSample,
    StandstillCheck,
)
from twind.robot.finding import Finding, ReasonCode


@dataclass
class Joint:
    """A shaft between two ends that follows its goal, and draws what the error drives, within its cap."""

    place: float
    stop: float
    way: int = 1
    gain: float = 12.0  # raw effort per count of error
    cap: float = 100.0
    fastest: float = 2000.0  # counts/s
    give: float = 0.0  # counts that the stop gives way with each touch
    load: float = 0.0  # raw effort along the way that something else pulls with
    other: float = -inf  # along `way`: the other end of its travel
    effort: float = 0.0

    def follow(self, goal: float) -> None:
        """One tick."""
        error = goal - self.place
        pull = max(-self.cap, min(self.cap, self.gain * error)) + self.load * self.way
        step = max(-self.fastest, min(self.fastest, 10.0 * pull)) * TICK
        step = max(-abs(error), min(abs(error), step)) if self.load == 0.0 else step
        wanted = self.place + step
        met = (wanted - self.stop) * self.way >= 0.0
        self.place = self.stop if met else self.way * max(self.other, self.way * wanted)
        self.effort = max(-self.cap, min(self.cap, self.gain * (goal - self.place)))

    def look(self, now: float) -> HomingSample:
        return HomingSample(now, round(self.place), self.effort)


def run(course: EndstopSearch, joint: Joint, seconds: float = 120.0, begin: float = 0.0) -> list[float]:
    """Until it is over; the goals."""
    goals = []
    now = begin
    while not course.done and now < begin + seconds:
        now += TICK
        goals.append(course.step(joint.look(now), now))
        joint.follow(goals[-1])
    return goals


@given(
    way=st.sampled_from((1, -1)),
    off=st.floats(-0.18, 0.18),
    far=st.floats(0.0, 2.0),
    speed=st.floats(0.05, 0.5),
    times=st.integers(2, 5),
)
@examples(60)
def test_a_stop_is_found_so_often_wherever_it_begins(
    way: int, off: float, far: float, speed: float, times: int
) -> None:
    search = replace(SEARCH, way=way, speed=speed * RAD, times=times)
    stop = search.expected + off * RAD
    joint = Joint(stop - way * far * RAD, stop, way)
    course = EndstopSearch(search, joint.place, 0.0)
    goals = run(course, joint, 600.0)
    assert course.phase is HomingPhase.FOUND, course.failed
    assert len(course.captures) == times
    assert all(abs(count - stop) <= 1.0 for count in course.captures)
    assert abs(joint.place - stop) >= 0.5 * search.back, "it is left pressed against its stop"
    end = search.expected + way * search.margin
    assert max(goal * way for goal in goals) <= end * way + 1e-6
    steps = [abs(b - a) for a, b in pairwise(goals)]
    assert max(steps) <= search.speed * TICK + 1e-6


@given(
    way=st.sampled_from((1, -1)),
    travel=st.floats(1.02, 4.0),
    start=st.floats(0.0, 1.0),
    obstacle=st.one_of(st.just(0.0), st.floats(0.0, 0.9), st.integers(1, 3)),
    nearer=st.integers(0, 3),
)
@example(way=1, travel=2.0, start=0.0, obstacle=0.03125, nearer=0)
@examples(60)
def test_over_turns_the_true_stop_is_found_or_none(
    way: int, travel: float, start: float, obstacle: float, nearer: int
) -> None:
    """An obstacle that many turns before the stop, where the count looks the same, never passes for it."""
    turn = 4096.0
    margin = 0.2 * RAD
    room = turn / 4
    end = 5000.0 * way  # of the travel; the search may expect the stop turns further
    away = travel * turn - turn + room + margin + SEARCH.back
    search = replace(
        SEARCH,
        way=way,
        expected=end + way * nearer * turn,
        speed=1.0 * RAD,
        turn=turn,
        margin=margin,
        away=away,
    )
    blocked = end * way - min(obstacle, travel - 0.05) * turn
    other = end * way - travel * turn
    joint = Joint(way * (other + start * (blocked - other)), way * blocked, way, other=other)
    course = EndstopSearch(search, joint.place, 0.0)
    run(course, joint, 600.0)
    if obstacle == 0.0:
        assert course.phase is HomingPhase.FOUND, course.failed
    if course.phase is HomingPhase.FOUND:
        assert obstacle * turn <= margin + 1.0
        assert course.turns_off == -way * nearer * turn
        # An obstacle as near to the stop as the margin passes for it.
        assert abs(abs(joint.place - joint.stop) - away) <= search.back


def test_the_search_starts_from_the_held_goal_and_not_from_the_reading() -> None:
    course = EndstopSearch(SEARCH, 2000.0, 0.0)
    joint = Joint(1990.0, 3000.0)  # it sags under its load
    first = course.step(joint.look(TICK), TICK)
    assert first == pytest.approx(2000.0 + SEARCH.speed * TICK)


def failing(joint: Joint, search: HomingParameters = SEARCH, start: float | None = None) -> Finding:
    course = EndstopSearch(search, joint.place if start is None else start, 0.0)
    run(course, joint, 600.0)
    assert course.phase is HomingPhase.FAILED and course.failed is not None
    before = course.goal
    assert course.step(joint.look(1e3), 1e3) == before, "it goes on after it has failed"
    return course.failed


def test_no_stop_where_it_should_be_ends_at_the_margin() -> None:
    joint = Joint(2500.0, 5000.0)
    found = failing(joint)
    assert found.code is ReasonCode.STOP_NOT_FOUND and "no stop" in found.message
    assert joint.place <= SEARCH.expected + SEARCH.margin + 1.0


def test_something_in_its_way_is_no_stop() -> None:
    found = failing(Joint(2500.0, 2700.0))
    assert found.value == pytest.approx(300.0, abs=2.0) and found.bound == SEARCH.margin


def test_captures_that_differ_are_refused() -> None:
    class Loose(Joint):
        away = False

        def follow(self, goal: float) -> None:
            super().follow(goal)
            if self.place > self.stop - 1.0:
                self.away = False
            elif self.place < self.stop - 30.0 and not self.away:
                self.away = True
                self.stop = self.stop + SPREAD + 2.0

    found = failing(Loose(2900.0, 3000.0))
    assert found.value is not None and found.value > SPREAD and found.bound == SPREAD


def test_a_joint_that_goes_the_other_way_is_let_go() -> None:
    found = failing(Joint(2500.0, 3000.0, load=-300.0))
    assert "against the way" in found.message
    assert found.value is not None and found.value < SEARCH.astray + 30.0


def test_a_joint_that_runs_ahead_of_its_goals_is_let_go() -> None:
    found = failing(Joint(2500.0, 3000.0, load=300.0))
    assert "runs away" in found.message


def test_held_back_without_effort_ends_it() -> None:
    for effort in (10.0, nan):

        class Numb(Joint):
            def look(self, now: float, effort: float = effort) -> HomingSample:
                return HomingSample(now, round(self.place), effort)

        found = failing(Numb(2900.0, 3000.0))
        assert found.code is ReasonCode.STOP_NOT_FOUND and "held back" in found.message


def test_a_joint_that_does_not_come_back_ends_it() -> None:
    class Stuck(Joint):
        def follow(self, goal: float) -> None:
            if self.place != self.stop:
                super().follow(goal)
            self.effort = max(-self.cap, min(self.cap, self.gain * (goal - self.place)))

    assert "does not come back" in failing(Stuck(2900.0, 3000.0)).message


def test_the_search_ends_within_its_time_limit() -> None:
    course = EndstopSearch(SEARCH, 2900.0, 0.0)
    now = 0.0
    while not course.done:
        now += TICK
        course.step(HomingSample(now - 0.05, 2900, 0.0), now)  # readings too old to go on by, and not lost
        assert now < 60.0
    assert course.failed is not None and "s have passed" in course.failed.message


def test_a_joint_too_slow_for_its_goals_is_held_back() -> None:
    class Sticky(Joint):
        def follow(self, goal: float) -> None:
            self.place += 0.3 * self.way
            self.effort = 0.5 * self.cap

    assert "held back" in failing(Sticky(1000.0, 3000.0)).message


def test_standing_without_effort_or_effort_in_motion_is_no_stop() -> None:
    course = EndstopSearch(SEARCH, 2950.0, 0.0)
    now = 0.0
    for tick in range(100):
        now += TICK
        moving = tick % 40 < 20
        course.step(
            HomingSample(now, 2950 + 4 * (tick % 2) if moving else 2950, 100.0 if moving else 40.0), now
        )
    assert not course.captures


def test_progress_grows_to_one() -> None:
    joint = Joint(2000.0, 3000.0)
    course = EndstopSearch(SEARCH, 2000.0, 0.0)
    told = []
    now = 0.0
    while not course.done:
        now += TICK
        joint.follow(course.step(joint.look(now), now))
        told.append(course.progress)
    assert told == sorted(told) and told[0] < 0.05 and told[-1] == 1.0


@given(st.lists(st.integers(-50, 50), min_size=1, max_size=60))
def test_quiet_is_so_many_readings_that_agree(jitter: list[int]) -> None:
    quiet = StandstillCheck(0.0)
    now = 0.0
    for place, each in enumerate(jitter):
        now += TICK
        answer = quiet.step(HomingSample(now, each, 0.0), now)
        last = jitter[max(0, place - 9) : place + 1]
        assert (answer is True) == (len(last) == 10 and max(last) - min(last) <= 3)


def test_the_standstill_check_fails_without_replies_or_with_oscillation() -> None:
    quiet = StandstillCheck(0.0)
    assert quiet.step(HomingSample(0.0, 5, 0.0), 2.9) is False
    silent = quiet.step(HomingSample(0.0, 5, 0.0), 3.0)
    assert isinstance(silent, Finding) and silent.code is ReasonCode.STOP_NOT_FOUND
    swinging = StandstillCheck(0.0)
    now = 0.0
    answer: bool | Finding = False
    while answer is False:
        now += TICK
        answer = swinging.step(HomingSample(now, round(400 * now) % 200, 0.0), now)
    assert isinstance(answer, Finding)
