from itertools import pairwise
from math import inf, nan

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tests.support.examples import examples
from tests.support.executor_rig import LIMITS, PERIOD, holding, only, phases, reading, run, smooth
from tests.support.gate_rig import ask, at_rest, path
from twind.motion.trajectory_executor import GoalOutcome, GoalTolerances, TrajectoryExecutor
from twind.robot.finding import ReasonCode
from twind.robot.modes import Motion
from twind.robot.trajectory import Trajectory
from twind.safety.gate import TrajectoryRequest

# ------------------------------------------------------------------------------------- idle and holding


def test_an_executor_without_a_position_stays_idle() -> None:
    executor = TrajectoryExecutor(LIMITS, PERIOD)
    assert (executor.motion, executor.reference, executor.goal(0.0)) == (Motion.IDLE, None, None)
    assert executor.progress() is None
    executor.stop()
    executor.observe(reading([0.0, 0.0]))
    assert executor.motion is Motion.IDLE
    with pytest.raises(ValueError, match="idle"):
        executor.ahead(0.0)


def test_idle_takes_neither_trajectories_nor_setpoints() -> None:
    executor = TrajectoryExecutor(LIMITS, PERIOD)
    for refused in (
        executor.submit("a", smooth([1.0, 1.0])),
        executor.setpoint(np.array([0]), np.array([0.1]), None, 0.1),
    ):
        assert refused is not None
        assert refused.code is ReasonCode.NOT_ARMED


def test_a_hold_repeats_the_same_place() -> None:
    executor = holding([0.5, -0.5])
    assert executor.motion is Motion.HOLDING
    assert all(reference.position.tolist() == [0.5, -0.5] for reference in run(executor, 0.1))


@pytest.mark.parametrize("place", [nan, inf, -inf])
def test_no_hold_at_a_place_that_is_no_number(place: float) -> None:
    with pytest.raises(ValueError, match="joint 1"):
        holding([0.0, place])


def test_begin_and_idle_abort_what_is_under_way() -> None:
    for end in (lambda it: it.begin(np.zeros(2)), lambda it: it.idle()):
        executor = holding()
        executor.submit("a", smooth([1.0, 1.0]))
        run(executor, 0.2)
        executor.submit("b", smooth([0.0, 0.0]), start_in=5.0)
        end(executor)
        assert phases(executor) == [("a", "aborted"), ("b", "aborted")]
        assert executor.motion in (Motion.IDLE, Motion.HOLDING)


# ------------------------------------------------------------------------------------------ following


def test_a_goal_is_followed_to_its_end_and_reported_once() -> None:
    executor = holding()
    assert executor.submit("a", smooth([1.0, -1.0])) is None
    assert (executor.motion, executor.progress()) == (Motion.ACTIVE, ("a", 0.0))
    run(executor, 0.5)
    assert executor.progress() == ("a", pytest.approx(0.5))
    assert executor.outcomes() == []
    assert run(executor, 0.5)[-1].position.tolist() == [1.0, -1.0]
    assert executor.motion is Motion.HOLDING
    (ended,) = executor.outcomes()
    assert (ended, ended.fraction) == (GoalOutcome("a", "succeeded"), 1.0)
    assert executor.outcomes() == []


@pytest.mark.parametrize("seconds", [0.005, 0.3, 0.7, 0.123, 1 / 3])
def test_a_goal_ends_on_its_last_point_whatever_its_duration(seconds: float) -> None:
    executor = holding()
    executor.submit("a", path([seconds], [[0.01, 0.02]]))
    assert run(executor, seconds + 2 * PERIOD)[-1].position.tolist() == [0.01, 0.02]
    assert phases(executor) == [("a", "succeeded")]


@pytest.mark.parametrize("shape", [0, 1, 2])
def test_the_reference_carries_velocity_and_acceleration_of_the_curve(shape: int) -> None:
    executor = holding()
    rest = [[0.0, 0.0]]
    executor.submit("a", path([1.0], [[1.0, 1.0]], rest if shape else None, rest if shape == 2 else None))
    track = run(executor, 0.9)
    position = np.array([reference.position for reference in track])
    velocity = np.array([reference.velocity for reference in track])
    assert np.gradient(position, PERIOD, axis=0)[1:-1] == pytest.approx(velocity[1:-1], abs=0.02)
    acceleration = np.array([reference.acceleration for reference in track])
    assert np.gradient(velocity, PERIOD, axis=0)[1:-1] == pytest.approx(acceleration[1:-1], abs=0.2)


def test_late_and_missed_ticks_re_time_the_motion_and_change_nothing_else() -> None:
    punctual = holding()
    late = holding()
    rng = np.random.default_rng(7)
    now = 0.0
    for executor in (punctual, late):
        executor.submit("a", smooth([1.0, -1.0]))
    for tick in range(120):
        step = float(rng.choice([0.01, 0.012, 0.5, 3.0]))
        now += step
        first = punctual.goal(tick * PERIOD)
        second = late.goal(now, int(step / PERIOD) - 1)
        assert first is not None
        assert second is not None
        assert (first.position == second.position).all()


@pytest.mark.parametrize("start_in", [nan, inf])
def test_a_start_that_never_comes_is_refused(start_in: float) -> None:
    refused = holding().submit("a", smooth([1.0, 1.0]), start_in=start_in)
    assert refused is not None
    assert refused.code is ReasonCode.TOO_DISTANT


def test_a_path_without_points_is_refused() -> None:
    refused = holding().submit("a", Trajectory(np.zeros(0), np.zeros((0, 2)), np.ones(2, bool)))
    assert refused is not None
    assert refused.code is ReasonCode.EMPTY


def test_numbers_that_are_none_never_leave_and_end_in_a_hold() -> None:
    executor = holding([0.5, 0.5])
    executor.submit("a", smooth([nan, 1.0]))
    assert all(reference.position.tolist() == [0.5, 0.5] for reference in run(executor, 0.1))
    (outcome,) = executor.outcomes()
    assert outcome.phase == "aborted"
    assert [finding.code for finding in outcome.findings] == [ReasonCode.INTERNAL]
    assert executor.motion is Motion.HOLDING


# ------------------------------------------------------------------------------- replacement and partial


def test_joints_that_a_goal_does_not_name_keep_their_old_path() -> None:
    old = holding()
    both = holding()
    for executor in (old, both):
        executor.submit("old", smooth([1.0, 1.0], 2.0))
        run(executor, 0.5)
    both.submit("new", only(0, smooth([0.0, 9.0])))
    for before, after in zip(run(old, 1.5), run(both, 1.5), strict=True):
        assert after.position[1] == before.position[1]
    assert both.reference is not None
    assert both.reference.position.tolist() == [0.0, 1.0]
    assert phases(both) == [("old", "replaced"), ("new", "succeeded")]


def test_the_motion_is_active_until_the_last_old_path_has_ended() -> None:
    executor = holding()
    executor.submit("old", smooth([1.0, 1.0], 2.0))
    executor.goal(0.0)
    executor.submit("new", only(0, smooth([0.5, 0.0], 0.5)))
    run(executor, 1.0)
    assert phases(executor) == [("old", "replaced"), ("new", "succeeded")]
    assert (executor.motion, executor.progress()) == (Motion.ACTIVE, None)
    run(executor, 1.0)
    assert executor.motion is Motion.HOLDING


def test_a_goal_with_a_later_start_waits_and_the_running_one_continues() -> None:
    executor = holding()
    alone = holding()
    for it in (executor, alone):
        it.submit("old", smooth([1.0, 1.0]))
    executor.submit("new", smooth([0.0, 0.0]), start_in=0.5)
    assert executor.waiting == 2  # the old one begins at the next tick
    for first, second in zip(run(executor, 0.5), run(alone, 0.5), strict=True):
        assert (first.position == second.position).all()
    assert (executor.progress(), phases(executor)) == (("old", pytest.approx(0.5)), [])
    run(executor, 1.0)
    assert executor.reference is not None
    assert executor.reference.position.tolist() == [0.0, 0.0]
    assert phases(executor) == [("old", "replaced"), ("new", "succeeded")]


def test_a_goal_that_waits_while_the_robot_holds_counts_as_active() -> None:
    executor = holding()
    executor.submit("a", smooth([1.0, 1.0]), start_in=0.5)
    assert (executor.motion, executor.progress()) == (Motion.ACTIVE, ("a", 0.0))


def test_a_newer_goal_replaces_those_that_were_to_begin_after_it() -> None:
    executor = holding()
    executor.submit("first", smooth([1.0, 1.0]), start_in=0.2)
    executor.submit("second", smooth([0.5, 0.5]), start_in=0.6)
    executor.submit("third", smooth([0.2, 0.2]), start_in=0.4)
    assert phases(executor) == [("second", "replaced")]
    run(executor, 2.0)
    assert phases(executor) == [("first", "replaced"), ("third", "succeeded")]


def test_two_goals_in_one_tick_leave_only_the_second() -> None:
    executor = holding()
    executor.submit("first", smooth([1.0, 1.0]))
    executor.submit("second", smooth([0.5, 0.5]))
    assert run(executor, 1.0)[-1].position.tolist() == [0.5, 0.5]
    assert phases(executor) == [("first", "replaced"), ("second", "succeeded")]


def test_ahead_is_where_the_reference_will_be() -> None:
    executor = holding()
    executor.submit("a", smooth([1.0, 1.0]))
    executor.submit("b", only(1, smooth([0.0, -1.0])), start_in=0.4)
    executor.submit("c", only(0, smooth([0.3, 0.0])), start_in=0.8)
    told = {seconds: executor.ahead(seconds) for seconds in (0.0, 0.1, 0.4, 0.41, 0.8, 1.2, 3.0)}
    assert executor.reference is told[0.0]
    track = run(executor, 3.0)
    for seconds, reference in told.items():
        if seconds:
            seen = track[round(seconds / PERIOD) - 1]
            assert reference.position == pytest.approx(seen.position, abs=1e-12)
            assert reference.velocity == pytest.approx(seen.velocity, abs=1e-9)


def test_a_first_point_at_zero_that_jumps_is_led_in_without_a_step() -> None:
    executor = holding()
    executor.submit("a", path([0.0, 1.0], [[0.05, -0.05], [0.5, -0.5]], [[0.0, 0.0], [0.0, 0.0]]))
    track = [at_rest([0.0, 0.0]), *run(executor, 1.5)]
    step = max(np.abs(after.position - before.position).max() for before, after in pairwise(track))
    assert step <= 4.0 * PERIOD
    assert track[-1].position.tolist() == [0.5, -0.5]


# ------------------------------------------------------------------- whatever happens, nothing steps


places = st.floats(-1.9, 1.9)
OPERATIONS = st.one_of(
    st.tuples(
        st.just("submit"),
        st.lists(st.tuples(places, places), min_size=1, max_size=3),
        st.tuples(
            st.sampled_from([0.15, 0.4, 1.0]), st.integers(0, 2), st.sampled_from([0.0, 0.0, 0.1, 0.35])
        ),
        st.sampled_from([(True, True), (True, False), (False, True)]),
    ),
    st.tuples(st.just("setpoint"), st.integers(0, 1), places, st.floats(-4.0, 4.0)),
    st.tuples(st.just("stop")),
    st.tuples(st.just("stray"), places),
    st.tuples(st.just("wait"), st.integers(1, 60)),
)


def perform(executor: TrajectoryExecutor, operation: tuple, tick: int) -> None:
    """One operation, through the gate where it has one."""
    if operation[0] == "submit":
        _, knots, (spacing, shape, start_in), mask = operation
        k = len(knots)
        rest = np.zeros((k, 2))
        time = spacing * np.arange(1, k + 1)
        asked = Trajectory(
            time, np.array(knots), np.array(mask), rest if shape else None, rest if shape == 2 else None
        )
        if executor.motion is Motion.STREAMING:
            start_in = 0.0
        judged = ask(asked, LIMITS, executor.ahead(start_in), TrajectoryRequest("retime"))
        if not judged.verdict.refusals:
            tolerances = GoalTolerances.from_entries(2, [(0, 0.5, 0.5)])
            assert executor.submit(f"{tick}", judged.path, start_in=start_in, tolerances=tolerances) is None
    elif operation[0] == "setpoint":
        _, joint, place, speed = operation
        executor.setpoint(np.array([joint]), np.array([place]), np.array([speed]), 0.1)
    elif operation[0] == "stop":
        executor.stop()
    elif operation[0] == "stray":
        executor.observe(reading([operation[1], 0.0]))


AT_THE_END_OF_BRAKING = ("submit", [(0.0, 0.0)], (0.15, 2, 0.1), (True, True))


@examples(60)
@given(st.lists(OPERATIONS, min_size=2, max_size=12))
def test_no_accepted_goal_steps_beyond_the_velocity_limit(
    operations: list[tuple],
) -> None:
    executor = holding()
    tick = 0
    track = [np.zeros(2)]
    ended: list[str] = []
    for operation in operations:
        perform(executor, operation, tick)
        for _ in range(operation[1] if operation[0] == "wait" else 7):
            tick += 1
            reference = executor.goal(tick * PERIOD)
            assert reference is not None
            track.append(reference.position)
            ended += [outcome.id for outcome in executor.outcomes() if outcome.id]
    executor.stop()
    ended += [outcome.id for outcome in executor.outcomes() if outcome.id]
    for _ in range(25):  # 4 rad/s at 20 rad/s² stop within 0.2 s
        reference = executor.goal(tick * PERIOD)
        assert reference is not None
        track.append(reference.position)
    assert (reference.velocity == 0.0).all()
    assert len(set(ended)) == len(ended), "a goal ended twice"
    position = np.array(track)
    assert np.abs(np.diff(position, axis=0)).max() <= 4.0 * PERIOD + 1e-9
    assert position.min() >= LIMITS.hard_lower[0]
    assert position.max() <= LIMITS.hard_upper[0]


# A goal that begins in the instant in which braking ends: its curve starts without acceleration.
@example([("setpoint", 0, 1.0, 0.0), ("stray", 0.0), ("stray", 0.0), ("stop",), AT_THE_END_OF_BRAKING], 6)
@examples(40)
@given(st.lists(OPERATIONS, min_size=1, max_size=6), st.integers(0, 80))
def test_the_reference_ahead_is_the_one_that_comes(operations: list[tuple], count: int) -> None:
    executor = holding()
    for number, operation in enumerate(operations):
        perform(executor, operation, number)
        run(executor, 0.05)
    if executor.motion is Motion.STREAMING:
        executor.stop()
    told = executor.ahead(count * PERIOD)
    track = run(executor, count * PERIOD)
    seen = track[-1] if track else executor.reference
    assert seen is not None
    assert told.position == pytest.approx(seen.position, abs=1e-9)
    assert told.velocity == pytest.approx(seen.velocity, abs=1e-6)
