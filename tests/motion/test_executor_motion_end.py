"""Motions that end before their time: tolerances, stops, and a stream of setpoints that runs dry."""

from itertools import pairwise
from math import inf, nan

import numpy as np
import pytest

from tests.support.executor_rig import PERIOD, holding, only, phases, reading, run, smooth
from tests.support.gate_rig import at_rest
from twind.motion.trajectory_executor import GoalOutcome, GoalTolerances, TrajectoryExecutor
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Motion

# ------------------------------------------------------------------------------------------ tolerances


def test_a_joint_off_its_path_aborts_the_goal_and_is_held_where_it_is() -> None:
    executor = holding()
    executor.submit(
        "a", smooth([1.0, 1.0]), tolerances=GoalTolerances.from_entries(2, [(0, 0.1, None), (1, 0.1, None)])
    )
    reference = run(executor, 0.5)[-1]
    executor.observe(reading([0.3, reference.position[1]]))
    (outcome,) = executor.outcomes()
    assert outcome.phase == "aborted"
    (finding,) = outcome.findings
    assert (finding.code, finding.joint, finding.bound) == (ReasonCode.PATH_TOLERANCE, 0, 0.1)
    assert finding.value == pytest.approx(0.2)
    assert finding.time == pytest.approx(0.5)
    assert executor.motion is Motion.HOLDING
    track = [reference, *run(executor, 1.0)]
    assert track[-1].position[0] == pytest.approx(0.3)
    stop = reference.position[1] + reference.velocity[1] ** 2 / 40.0
    assert track[-1].position[1] == pytest.approx(stop, abs=1e-9)
    assert max(np.abs(b.position - a.position).max() for a, b in pairwise(track)) <= 4.0 * PERIOD + 1e-12
    assert executor.outcomes() == []


def test_a_joint_within_its_path_tolerance_goes_on() -> None:
    executor = holding()
    executor.submit("a", smooth([1.0, 1.0]), tolerances=GoalTolerances.from_entries(2, [(0, 0.1, None)]))
    reference = run(executor, 0.5)[-1]
    executor.observe(reading([reference.position[0] - 0.0999, -9.0]))
    assert executor.outcomes() == []


def test_a_position_that_is_no_number_is_off_the_path_and_not_held_at() -> None:
    executor = holding()
    executor.submit("a", smooth([1.0, 1.0]), tolerances=GoalTolerances.from_entries(2, [(0, 0.1, None)]))
    run(executor, 0.5)
    executor.observe(reading([nan, 0.0]))
    assert phases(executor) == [("a", "aborted")]
    assert np.isfinite(run(executor, 1.0)[-1].position).all()


def test_an_executor_that_cancels_its_way_back_stops() -> None:
    executor = holding()
    executor.submit("a", smooth([1.0, 1.0]), tolerances=GoalTolerances.from_entries(2, [(0, 0.1, None)]))
    run(executor, 0.9)
    executor.observe(reading([-1.0, 0.0]))
    run(executor, 0.3)
    executor.stop()
    place = run(executor, 0.5)[-1].position[0]
    assert place > -0.9
    assert run(executor, 0.5)[-1].position[0] == place


def arrived(goal_time: float | None = None) -> TrajectoryExecutor:
    executor = holding()
    tolerances = GoalTolerances.from_entries(2, [(0, None, 0.1)])
    executor.submit("a", smooth([1.0, 1.0]), tolerances=tolerances, goal_time=goal_time)
    run(executor, 1.0)
    return executor


def test_with_a_goal_tolerance_the_goal_ends_when_the_robot_is_there_and_has_stopped() -> None:
    executor = arrived()
    for place, speed in ([0.8, 0.0], [1.0, 0.06], [1.0, nan], [nan, 0.0]):
        executor.observe(reading([place, 0.0], [speed, 9.0]))
        assert executor.outcomes() == []
        assert executor.motion is Motion.ACTIVE
    executor.observe(reading([0.95, 0.0], [0.05, 9.0]))
    assert phases(executor) == [("a", "succeeded")]
    executor.goal(0.0)
    assert executor.motion is Motion.HOLDING


def test_a_default_goal_tolerance_judges_the_place_and_not_the_speed() -> None:
    executor = holding()
    executor.submit(
        "a", smooth([1.0, 1.0]), tolerances=GoalTolerances.from_entries(2, [], 0.2), goal_time=0.5
    )
    run(executor, 1.0)
    executor.observe(reading([1.0, 0.79], [1.0, 1.0]))
    assert executor.outcomes() == []
    executor.observe(reading([1.19, 0.81], [1.0, nan]))
    assert phases(executor) == [("a", "succeeded")]


def test_a_default_goal_tolerance_does_not_judge_joints_that_the_goal_does_not_move() -> None:
    executor = holding()
    executor.submit(
        "a", only(0, smooth([1.0, 0.0])), tolerances=GoalTolerances.from_entries(2, [], 0.2), goal_time=0.5
    )
    run(executor, 1.0)
    executor.observe(reading([1.0, 3.0]))
    assert phases(executor) == [("a", "succeeded")]


@pytest.mark.parametrize("goal_time", [None, 0.0])
def test_without_a_goal_time_the_goal_waits_for_ever(goal_time: float | None) -> None:
    executor = arrived(goal_time)
    for _ in range(1000):
        executor.goal(0.0)
        executor.observe(reading([0.5, 0.0]))
    assert executor.outcomes() == []


def test_after_its_goal_time_a_goal_out_of_tolerance_is_aborted() -> None:
    executor = arrived(0.2)
    for _ in range(20):
        executor.observe(reading([0.5, 0.0]))
        executor.goal(0.0)
    assert executor.outcomes() == []
    executor.goal(0.0)
    executor.observe(reading([0.5, 0.0]))
    (outcome,) = executor.outcomes()
    assert [finding.code for finding in outcome.findings] == [ReasonCode.GOAL_TOLERANCE]
    assert run(executor, 1.0)[-1].position == pytest.approx([0.5, 1.0])


def test_an_abort_takes_the_goals_that_wait_with_it() -> None:
    executor = holding()
    executor.submit("a", smooth([1.0, 1.0]), tolerances=GoalTolerances.from_entries(2, [(0, 0.1, None)]))
    run(executor, 0.5)
    executor.submit("b", smooth([0.0, 0.0]), start_in=0.3)
    executor.observe(reading([0.0, 0.0]))
    assert phases(executor) == [("a", "aborted"), ("b", "aborted")]


# ------------------------------------------------------------------------------------------------ stop


def test_a_cancel_brakes_with_the_acceleration_limit_and_then_holds() -> None:
    executor = holding()
    executor.submit("a", smooth([1.0, -1.0]))
    executor.submit("b", smooth([0.0, 0.0]), start_in=3.0)
    before = run(executor, 0.5)[-1]
    executor.stop()
    assert executor.motion is Motion.HOLDING
    assert phases(executor) == [("a", "cancelled"), ("b", "cancelled")]
    track = [before, *run(executor, 0.3)]
    speeds = np.array([reference.velocity for reference in track])
    assert np.abs(np.diff(speeds, axis=0)).max() <= 20.0 * PERIOD + 1e-9
    expected = before.position + before.velocity * np.abs(before.velocity) / 40.0
    assert track[-1].position == pytest.approx(expected, abs=1e-12)
    assert (track[-1].velocity == 0.0).all()


def test_stopping_again_while_braking_changes_nothing() -> None:
    once = holding()
    often = holding()
    for executor in (once, often):
        executor.submit("a", smooth([1.0, -1.0]))
        run(executor, 0.5)
        executor.stop()
    for _ in range(30):
        often.stop()
        first = once.goal(0.0)
        second = often.goal(0.0)
        assert first is not None
        assert second is not None
        assert (first.position == second.position).all()


def test_a_stop_carries_its_cause_into_the_outcome() -> None:
    executor = holding()
    executor.submit("a", smooth([1.0, 1.0]))
    lost = Finding(ReasonCode.LEASE_LOST)
    executor.stop("aborted", (lost,))
    assert executor.outcomes() == [GoalOutcome("a", "aborted", (lost,))]


# ---------------------------------------------------------------------------------------------- stream


def stream(executor: TrajectoryExecutor, place: float, *, joint: int = 0, speed: float | None = None) -> None:
    velocity = None if speed is None else np.array([speed])
    assert executor.setpoint(np.array([joint]), np.array([place]), velocity, 0.1) is None


def test_setpoints_are_followed_within_the_limits_and_others_hold() -> None:
    executor = holding()
    track = [at_rest([0.0, 0.0])]
    for tick in range(100):
        if tick % 5 == 0:
            stream(executor, 0.6)
        reference = executor.goal(tick * PERIOD)
        assert reference is not None
        track.append(reference)
        assert executor.motion is Motion.STREAMING
    assert track[-1].position == pytest.approx([0.6, 0.0])
    speeds = np.array([reference.velocity for reference in track])
    assert np.abs(np.diff(speeds, axis=0)).max() <= 20.0 * PERIOD + 1e-9
    assert executor.progress() is None


def test_a_stream_with_velocities_is_followed_at_its_speed() -> None:
    executor = holding()
    for tick in range(100):
        if tick % 5 == 0:
            stream(executor, 0.5 * tick * PERIOD, speed=0.5)
        reference = executor.goal(tick * PERIOD)
        assert reference is not None
        if tick > 50:
            assert reference.velocity[0] == pytest.approx(0.5, abs=1e-6)


def test_an_expired_setpoint_ramps_to_a_hold_and_reports_stream_stale() -> None:
    executor = holding()
    stream(executor, 1.5, speed=1.0)
    assert executor.setpoint_age(0.0) == 0.0
    for tick in range(10):
        executor.goal(5.0 + tick * PERIOD)
        assert executor.motion is Motion.STREAMING
    assert executor.setpoint_age(5.1) == pytest.approx(0.1)
    before = executor.reference
    after = executor.goal(5.111)
    assert before is not None
    assert after is not None
    assert executor.motion is Motion.HOLDING
    assert executor.setpoint_age(5.2) is None
    assert np.abs(after.velocity) == pytest.approx(np.abs(before.velocity) - [0.2, 0.0])
    (outcome,) = executor.outcomes()
    (finding,) = outcome.findings
    assert (outcome.id, outcome.phase, finding.code, finding.bound) == (
        "",
        "aborted",
        ReasonCode.STREAM_STALE,
        0.1,
    )


@pytest.mark.parametrize("joined", [False, True], ids=["named with the other", "widened by the other"])
@pytest.mark.parametrize(("place", "speed"), [(0.0, 1.0), (1.5, 0.0)], ids=["at a speed", "to a far target"])
def test_a_joint_that_a_stream_names_no_more_holds_while_the_stream_goes_on(
    place: float, speed: float, joined: bool
) -> None:
    executor = holding()
    if not joined:
        executor.setpoint(np.array([0, 1]), np.zeros(2), None, 0.1)
    executor.setpoint(np.array([0]), np.array([place]), np.array([speed]), 0.1)
    track = []
    for tick in range(200):
        if tick % 5 == 0:
            assert executor.setpoint(np.array([1]), np.array([0.2]), None, 0.1) is None
        reference = executor.goal(PERIOD * tick)
        assert reference is not None
        track.append(reference)
    assert executor.motion is Motion.STREAMING
    assert track[9].velocity[0] > 0.5
    speeds = np.array([reference.velocity[0] for reference in track])
    fastest = int(np.argmax(speeds))
    assert fastest <= 11  # the ticks of 0.1 s
    assert (np.diff(speeds[fastest:]) <= 1e-9).all()  # it never turns back
    assert speeds.min() >= -1e-9
    assert (speeds[40:] == 0.0).all()
    assert track[-1].position[1] == pytest.approx(0.2)


def test_a_motion_that_arrives_with_the_last_moment_of_a_stream_begins() -> None:
    executor = holding()
    stream(executor, 1.5, speed=1.0)
    for tick in range(10):
        executor.goal(5.0 + tick * PERIOD)
    assert executor.submit("a", smooth([1.0, 1.0])) is None
    executor.goal(5.111)
    assert executor.motion is Motion.ACTIVE
    assert executor.outcomes() == []


@pytest.mark.parametrize("now", [nan, inf])
def test_a_time_that_is_no_time_ends_the_stream(now: float) -> None:
    executor = holding()
    stream(executor, 1.0)
    executor.goal(0.0)
    executor.goal(now)
    assert executor.motion is Motion.HOLDING


@pytest.mark.parametrize("bad", [nan, inf])
def test_a_setpoint_that_is_no_number_is_refused_and_changes_nothing(bad: float) -> None:
    executor = holding()
    for position, velocity, valid in ((bad, 0.0, 0.1), (0.0, bad, 0.1), (0.0, 0.0, bad)):
        refused = executor.setpoint(np.array([0]), np.array([position]), np.array([velocity]), valid)
        assert refused is not None
        assert refused.code is ReasonCode.NONFINITE
    assert executor.motion is Motion.HOLDING


def test_a_stream_replaces_the_goals_and_leaves_other_joints_their_path() -> None:
    executor = holding()
    alone = holding()
    for it in (executor, alone):
        it.submit("a", smooth([1.0, 1.0]))
    run(executor, 0.5)
    executor.submit("later", smooth([0.0, 0.0]), start_in=1.0)
    stream(executor, 0.2)
    assert phases(executor) == [("a", "replaced"), ("later", "replaced")]
    expected = run(alone, 0.6)[-1]
    assert run(executor, 0.1)[-1].position[1] == expected.position[1]
    assert executor.motion is Motion.STREAMING


def test_a_joint_that_joins_the_stream_begins_from_its_reference() -> None:
    executor = holding()
    executor.submit("a", smooth([1.0, 1.0]))
    track = run(executor, 0.5)
    for joint in (0, 1):
        stream(executor, -0.5, joint=joint)
        track += run(executor, 0.05)
    stream(executor, -0.5)
    track += run(executor, 0.05)
    position = np.array([reference.position for reference in track])
    assert np.abs(np.diff(position, axis=0)).max() <= 4.0 * PERIOD
    speeds = np.array([reference.velocity for reference in track[50:]])
    assert np.abs(np.diff(speeds, axis=0)).max() <= 20.0 * PERIOD + 1e-9


def test_a_goal_ends_the_stream_and_its_other_joints_brake() -> None:
    executor = holding()
    stream(executor, 1.5, joint=1)
    run(executor, 0.1)
    executor.submit("a", only(0, smooth([0.5, 0.0])))
    run(executor, 1.0)
    assert executor.motion is Motion.HOLDING
    assert phases(executor) == [("a", "succeeded")]
    assert executor.reference is not None
    assert executor.reference.position[0] == 0.5
    assert 0.1 < executor.reference.position[1] < 0.3


def test_while_setpoints_arrive_a_later_start_is_refused() -> None:
    executor = holding()
    stream(executor, 0.5)
    refused = executor.submit("a", smooth([1.0, 1.0]), start_in=0.5)
    assert refused is not None
    assert refused.code is ReasonCode.BUSY


def test_cancel_ends_a_stream() -> None:
    executor = holding()
    stream(executor, 1.5)
    run(executor, 0.1)
    executor.stop()
    assert executor.motion is Motion.HOLDING
    run(executor, 0.5)
    assert executor.reference is not None
    assert (executor.reference.velocity == 0.0).all()
    assert executor.outcomes() == []
