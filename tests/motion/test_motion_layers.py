"""Layers of motion: what a goal becomes when it begins, its own time, and who decides which joint."""

from dataclasses import replace
from math import inf, nan

import numpy as np
import pytest

from tests.support.gate_rig import at_rest, limits, path
from twind.motion.goal_conditions import GoalTolerances
from twind.motion.motion_layers import (
    MotionLayer,
    ScheduledGoal,
    begun,
    choose,
    displaced,
    overlay,
    without,
)
from twind.robot.finding import Finding, ReasonCode
from twind.robot.trajectory import Trajectory

PERIOD = 0.01


def layer(to: list[float], joints: list[bool], start: int = 0, seconds: float = 1.0) -> MotionLayer:
    way = path([seconds], [to], [[0.0] * 3])
    goal = ScheduledGoal(
        "a", Trajectory(way.time, way.position, np.array(joints), way.velocity), start, None, None
    )
    return begun(goal, at_rest([0.0, 0.0, 0.0]), limits(3), PERIOD)


def test_a_layer_begins_at_the_reference_and_ends_on_its_last_point() -> None:
    one = layer([0.1, 0.2, 0.3], [True, True, True], start=50)
    assert one.whole
    assert one.reference_at(50).position.tolist() == [0.0, 0.0, 0.0]
    assert not one.is_finished(149)
    assert one.is_finished(150)
    assert one.reference_at(150).position.tolist() == [0.1, 0.2, 0.3]
    assert [one.fraction(tick) for tick in (50, 100, 150, 900)] == pytest.approx([0.0, 0.5, 1.0, 1.0])
    assert layer([0.1, 0.2, 0.3], [True, True, True], seconds=2.0).fraction(50) == pytest.approx(0.25)


@pytest.mark.parametrize("seconds", [0.3, 0.07, 0.29, 0.57, 1.13])
def test_the_tick_of_the_end_is_at_the_end_whatever_the_rounding(seconds: float) -> None:
    one = layer([0.1, 0.1, 0.1], [True, True, True], start=12345, seconds=seconds)
    end = 12345 + round(seconds / PERIOD)
    assert one.elapsed(end) == seconds
    assert one.is_finished(end)


def test_a_nanosecond_before_the_end_is_the_end_and_more_is_not() -> None:
    near = layer([0.1, 0.1, 0.1], [True, True, True], seconds=1.0 + 0.95e-9)
    assert near.is_finished(100)
    assert near.elapsed(100) == 1.0 + 0.95e-9
    assert not layer([0.1, 0.1, 0.1], [True, True, True], seconds=1.0 + 1.05e-9).is_finished(100)


def test_a_path_of_one_point_at_zero_has_come_all_the_way_at_once() -> None:
    here = ScheduledGoal("a", path([0.0], [[0.0, 0.0, 0.0]]), 0, None, None)
    one = begun(here, at_rest([0.0, 0.0, 0.0]), limits(3), PERIOD)
    assert one.is_finished(0)
    assert one.fraction(0) == 1.0


def test_joints_leave_a_layer_and_one_that_all_have_left_is_gone() -> None:
    first = layer([1, 1, 1], [True, True, False])
    second = layer([2, 2, 2], [False, False, True])
    left = without([first, second], np.array([True, False, True]))
    assert [one.joints.tolist() for one in left] == [[False, True, False]]
    assert not left[0].whole
    assert not first.whole
    assert without(left, np.array([False, True, False])) == []
    assert first.joints.tolist() == [True, True, False]


def test_each_joint_follows_its_own_layer_and_the_rest_the_base() -> None:
    layers = [layer([1, 1, 1], [True, False, False]), layer([2, 2, 2], [False, True, False])]
    mixed = overlay(at_rest([7.0, 7.0, 7.0]), layers, 100)
    assert mixed.position.tolist() == [1.0, 2.0, 7.0]
    moving = overlay(at_rest([7.0, 7.0, 7.0]), layers, 50)
    assert moving.velocity.tolist() == pytest.approx([1.5, 3.0, 0.0])


def test_choosing_takes_all_three_rows() -> None:
    one = choose(np.array([True, False]), at_rest([1.0, 1.0]), at_rest([2.0, 2.0]))
    assert one.position.tolist() == [1.0, 2.0]


def tolerances(goal: float) -> GoalTolerances:
    """Tolerances of the last joint's goal alone."""
    return GoalTolerances(np.zeros(3), np.array([inf, inf, goal]), np.full(3, inf))


@pytest.mark.parametrize(
    ("given", "judged"), [(None, False), (tolerances(inf), False), (tolerances(0.1), True)]
)
def test_a_goal_is_judged_at_its_end_where_a_joint_has_a_goal_tolerance(
    given: GoalTolerances | None, judged: bool
) -> None:
    goal = ScheduledGoal("a", path([1.0], [[0.0] * 3]), 0, given, None)
    assert goal.judged_at_end is judged


# ------------------------------------------------------------------------------- its own time

SLOW = (ReasonCode.LOOKAHEAD_COLLISION,)


def slowed(one: MotionLayer, tick: int, share: float, reasons: tuple[ReasonCode, ...] = SLOW) -> float:
    """The pace after one tick."""
    one.keep_pace(tick, share, reasons, limits(3))
    return one.pace.now


def test_a_motion_at_full_pace_has_lost_no_time_and_has_no_reason() -> None:
    one = layer([0.1, 0.2, 0.3], [True, True, True])
    assert slowed(one, 50, 1.0) == 1.0
    assert one.pace.even
    assert one.pace.lag == 0.0
    assert one.stretch.reasons == ()


def test_a_motion_becomes_slower_by_its_limits_and_as_fast_again() -> None:
    one = layer([0.1, 0.2, 0.3], [True, True, True])
    pace = slowed(one, 50, 0.0)
    assert 0.0 < pace < 1.0
    assert one.elapsed(51) == pytest.approx(0.5 + pace * PERIOD)
    assert one.stretch.reasons == SLOW
    here = one.curve.sample(one.elapsed(51))
    assert here is not None
    assert one.reference_at(51).velocity == pytest.approx(here.velocity * pace)
    ticks = range(51, 90)
    assert max(slowed(one, tick, 1.0) for tick in ticks) == 1.0
    assert one.pace.even
    assert 0.0 < one.pace.lag < 2.0


def test_after_its_end_a_motion_is_at_full_pace_again_and_loses_no_time() -> None:
    one = layer([0.1, 0.2, 0.3], [True, True, True], seconds=1.0)
    one.pace.step(0.5)
    assert one.elapsed(100) < 1.0
    one.pace.lag = 0.0
    assert slowed(one, 100, 0.0) == 1.0
    assert slowed(one, 101, 0.0) == 1.0
    assert one.pace.even
    assert one.pace.lag == 0.0
    assert one.stretch.reasons == ()


@pytest.mark.parametrize(("tick", "missed"), [(9, 0), (10, 0), (11, 3), (109, 3), (110, 0), (200, 0)])
def test_missed_ticks_make_a_motion_longer_that_has_begun_and_not_ended(tick: int, missed: int) -> None:
    one = layer([0.1, 0.2, 0.3], [True, True, True], start=10)
    one.miss(tick, 3)
    assert one.pace.missed == missed
    assert one.stretch.reasons == ((ReasonCode.LOOP_LATE,) if missed else ())
    one.miss(50, 2)
    assert one.pace.missed == missed + 2


def test_the_time_that_a_motion_lost_is_stated_to_a_microsecond() -> None:
    one = layer([0.1, 0.2, 0.3], [True, True, True])
    one.pace.lag = 0.12345678
    one.pace.missed = 2
    one.pace.blame(SLOW)
    stretch = one.stretch
    assert (stretch.duration, stretch.added, stretch.reasons) == (1.0, 0.021235, SLOW)


# ------------------------------------------------------------------------------- what is judged


def test_a_joint_of_the_goal_is_outside_beyond_its_bound_or_without_a_reading() -> None:
    one = layer([1, 1, 1], [True, True, False])
    bound = np.full(3, 0.1)
    assert one.outside(np.array([0.2, 0.1, 0.2]), bound).tolist() == [True, False, False]
    assert one.outside(np.array([0.0, nan, nan]), bound).tolist() == [False, True, False]
    assert one.outside(np.array([9.0, nan, 9.0]), np.full(3, inf)).tolist() == [False, False, False]


def waiting(start: list[float] | None) -> ScheduledGoal:
    goal = layer([1, 1, 1], [True, True, False]).goal
    return goal if start is None else replace(goal, foreseen=np.array(start))


@pytest.mark.parametrize("start", [None, [0.5, 0.5, 0.5], [0.5, 0.5, 0.9]])
def test_a_goal_begins_where_its_joints_are_as_judged(start: list[float] | None) -> None:
    assert displaced(waiting(start), at_rest([0.5, 0.5, 0.5])) is None


def test_a_goal_does_not_begin_where_a_joint_is_off_by_more_than_rounding() -> None:
    assert displaced(waiting([1e-9, 0.0, 0.0]), at_rest([0.0, 0.0, 0.0])) is None
    found = displaced(waiting([0.5, 0.7, 0.9]), at_rest([0.4, 0.3, 0.0]))
    assert found == Finding(
        ReasonCode.START_JUMP,
        1,
        value=pytest.approx(0.4),
        bound=1e-9,
        message="rad from where it was to begin: what moved before was slowed down",
    )
    assert displaced(waiting([0.0, 2e-9, 0.0]), at_rest([0.0, 0.0, 0.0])) is not None
