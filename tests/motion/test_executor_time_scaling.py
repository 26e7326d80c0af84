"""A slowed motion: the same path, no limit exceeded, the same end, and a stop as quick as ever."""

from math import inf, nan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import examples
from tests.support.executor_rig import LIMITS, PERIOD, holding, only, phases, reading, run, smooth
from tests.support.gate_rig import path
from twind.motion.trajectory_executor import GoalTolerances, TrajectoryExecutor
from twind.robot.arrays import Floats
from twind.robot.finding import ReasonCode
from twind.robot.modes import Motion
from twind.robot.trajectory import Trajectory

SHARES = st.one_of(st.sampled_from([0.0, 1.0]), st.floats(0.0, 1.0))
PACES = st.lists(st.tuples(SHARES, st.integers(1, 40)), max_size=12)


def fast(seconds_scale: float = 1.0) -> Trajectory:
    """A way there and back that takes nearly all that the limits allow, as one smooth curve."""
    a = float(LIMITS.acceleration[0])
    v = float(LIMITS.velocity[0])
    step = min(0.6, 0.8 * float(LIMITS.upper[0]))
    seconds = seconds_scale * max(1.875 * step / v, np.sqrt(5.774 * step / a)) / 0.98
    zero = [[0.0, 0.0]]
    return path([seconds], [[step, -0.7 * step]], zero, zero)


def track(executor: TrajectoryExecutor, paces: list[tuple[float, int]]) -> Floats:
    """Positions (k, n) of every tick, from the hold before to the hold after."""
    rows = [executor.reference.position]  # type: ignore[union-attr]
    for share, ticks in paces:
        executor.pace = share
        rows += [executor.goal(0.0).position for _ in range(ticks)]  # type: ignore[union-attr]
    executor.pace = 1.0
    for _ in range(2000):
        rows.append(executor.goal(0.0).position)  # type: ignore[union-attr]
        if executor.motion is Motion.HOLDING:
            break
    return np.array([rows[0], *rows, rows[-1]])


def assert_within_limits(rows: Floats) -> None:
    speed = np.diff(rows, axis=0) / PERIOD
    assert (np.abs(speed) <= LIMITS.velocity * (1 + 1e-9)).all()
    bend = np.diff(speed, axis=0) / PERIOD
    assert (np.abs(bend) <= LIMITS.acceleration * (1 + 1e-6) + 1e-6).all()


@examples(60)
@given(PACES, st.floats(1.0, 3.0))
def test_any_sequence_of_paces_keeps_every_limit_and_ends_at_the_same_place(
    paces: list[tuple[float, int]], scale: float
) -> None:
    executor = holding()
    way = fast(scale)
    executor.submit("a", way)
    rows = track(executor, paces)
    assert_within_limits(rows)
    assert rows[-1] == pytest.approx(way.position[-1], abs=1e-12)
    assert phases(executor) == [("a", "succeeded")]


@examples(30)
@given(PACES)
def test_a_slowed_path_is_the_same_path(paces: list[tuple[float, int]]) -> None:
    """Both joints share one curve: whatever the pace, the second is where the first says."""
    executor = holding()
    executor.submit("a", fast())
    rows = track(executor, paces)
    assert rows[:, 1] == pytest.approx(-0.7 * rows[:, 0], abs=1e-12)


def test_the_pace_comes_down_and_up_again_as_fast_as_the_acceleration_allows() -> None:
    executor = holding()
    executor.submit("a", path([4.0], [[1.2, 0.0]], [[0.0, 0.0]], [[0.0, 0.0]]))
    run(executor, 2.0)
    top = abs(executor.reference.velocity[0])  # type: ignore[union-attr]
    executor.pace = 0.25
    ticks = 0
    while executor.reference.velocity[0] > 0.26 * top:  # type: ignore[union-attr]
        executor.goal(0.0)
        ticks += 1
    needed = 0.74 * top / float(LIMITS.acceleration[0]) / PERIOD
    assert needed <= ticks <= 2.0 * needed + 3
    assert executor.slowed


def test_an_unslowed_motion_is_bit_for_bit_what_it_was() -> None:
    one = holding()
    other = holding()
    for executor in (one, other):
        executor.submit("a", smooth([0.5, -0.5]))
    other.pace = 1.0
    for _ in range(150):
        assert one.goal(0.0).position.tobytes() == other.goal(0.0).position.tobytes()  # type: ignore[union-attr]
    assert not one.slowed


def test_at_pace_zero_a_motion_stands_and_is_still_under_way() -> None:
    executor = holding()
    executor.submit("a", smooth([0.5, -0.5], 2.0))
    run(executor, 1.0)
    executor.pace = 0.0
    run(executor, 1.0)
    stands = executor.reference
    assert stands is not None
    assert np.abs(stands.velocity).max() == 0.0
    assert run(executor, 1.0)[-1].position.tolist() == stands.position.tolist()
    assert executor.motion is Motion.ACTIVE
    _, share = executor.progress()  # type: ignore[misc]
    assert 0.4 < share < 0.9
    executor.pace = 1.0
    run(executor, 2.0)
    assert phases(executor) == [("a", "succeeded")]


@pytest.mark.parametrize("share", [nan, -1.0, -inf])
def test_a_pace_that_is_none_stands(share: float) -> None:
    executor = holding()
    executor.pace = share
    assert executor.pace == 0.0
    executor.pace = inf
    assert executor.pace == 1.0


@pytest.mark.parametrize("share", [0.0, 0.3, 0.7])
def test_a_stop_is_never_slower_for_it(share: float) -> None:
    slowed = holding()
    free = holding()
    for executor in (slowed, free):
        executor.submit("a", fast(1.0))
        run(executor, 0.2)
    slowed.pace = share
    for _ in range(5):
        slowed.goal(0.0)
        free.goal(0.0)
    lasts = []
    for executor in (slowed, free):
        executor.stop()
        ticks = 0
        while np.abs(executor.reference.velocity).max() > 0.0:  # type: ignore[union-attr]
            executor.goal(0.0)
            ticks += 1
        lasts.append(ticks)
    assert lasts[0] <= lasts[1]


def test_a_new_goal_takes_over_from_a_slowed_one_without_a_step() -> None:
    executor = holding()
    executor.submit("a", path([3.0], [[0.9, 0.2]], [[0.0, 0.0]], [[0.0, 0.0]]))
    run(executor, 1.5)
    executor.pace = 0.4
    run(executor, 0.4)
    before = executor.reference
    assert before is not None
    executor.pace = 1.0
    executor.submit("b", path([2.0], [[0.0, 0.0]], [[0.0, 0.0]], [[0.0, 0.0]]))
    after = executor.goal(0.0)
    assert after is not None
    bend = np.abs((after.position - before.position) / PERIOD - before.velocity) / PERIOD
    assert (bend <= LIMITS.acceleration).all()
    assert run(executor, 2.5)[-1].position == pytest.approx([0.0, 0.0], abs=1e-12)
    assert phases(executor) == [("a", "replaced"), ("b", "succeeded")]


def test_the_time_for_the_goal_tolerances_is_that_of_the_clock() -> None:
    """Slowed until the end, then `goal_time` s of the clock, whatever the pace says."""
    executor = holding()
    demand = GoalTolerances.from_entries(2, [(0, None, 0.01)])
    executor.submit("a", smooth([0.3, 0.0]), tolerances=demand, goal_time=0.5)
    executor.pace = 0.5
    ended = over = 0
    for tick in range(600):
        executor.goal(0.0)
        executor.observe(reading([0.0, 0.0]))
        progress = executor.progress()
        if not over and (progress is None or progress[1] >= 1.0):
            over = tick
        if phases(executor):
            ended = tick
            break
    assert over * PERIOD > 1.5, "at half the pace it takes twice as long"
    assert (ended - over) * PERIOD == pytest.approx(0.5, abs=2 * PERIOD)


def test_a_path_tolerance_is_judged_by_the_slowed_reference() -> None:
    executor = holding()
    executor.submit("a", smooth([0.5, 0.0]), tolerances=GoalTolerances.from_entries(2, [(0, 0.05, None)]))
    executor.pace = 0.3
    for _ in range(700):
        reference = executor.goal(0.0)
        assert reference is not None
        executor.observe(reading(reference.position.tolist()))
    assert phases(executor) == [("a", "succeeded")]


def test_a_delayed_start_is_refused_while_slowed_and_aborted_off_its_predicted_place() -> None:
    executor = holding()
    executor.submit("a", smooth([0.5, -0.5], 2.0))
    executor.submit("b", smooth([0.0, 0.0], 2.0), start_in=1.0)
    run(executor, 0.5)
    executor.pace = 0.2
    refused = executor.submit("c", smooth([0.2, 0.0]), start_in=3.0)
    assert refused is not None
    assert refused.code is ReasonCode.BUSY
    run(executor, 0.6)
    (ended,) = executor.outcomes()
    assert (ended.id, ended.phase, ended.findings[0].code) == ("b", "aborted", ReasonCode.START_JUMP)
    executor.pace = 1.0
    run(executor, 3.0)
    assert phases(executor) == [("a", "succeeded")], "what runs goes on"


def test_starts_stay_on_the_clock_where_nothing_was_slowed() -> None:
    executor = holding()
    executor.submit("a", smooth([0.3, 0.3]), start_in=0.5)
    executor.pace = 0.5
    run(executor, 0.5)
    executor.pace = 1.0
    run(executor, 1.0)
    assert phases(executor) == [("a", "succeeded")]


@examples(20)
@given(PACES)
def test_a_stream_and_what_is_left_of_a_motion_keep_their_limits_at_any_pace(
    paces: list[tuple[float, int]],
) -> None:
    executor = holding()
    executor.submit("a", only(0, fast()))
    run(executor, 0.05)
    executor.setpoint(np.array([1]), np.array([0.4]), None, 1e3)
    rows = [executor.reference.position]  # type: ignore[union-attr]
    for share, ticks in paces:
        executor.pace = share
        rows += [executor.goal(0.0).position for _ in range(ticks)]  # type: ignore[union-attr]
    speed = np.diff(np.array(rows), axis=0) / PERIOD
    assert (np.abs(speed) <= LIMITS.velocity * (1 + 1e-9)).all()
    bend = np.diff(speed, axis=0) / PERIOD
    assert (np.abs(bend) <= LIMITS.acceleration * (1 + 1e-6) + 1e-6).all()


# ------------------------------------------------------------------------------------- a motion's own time


@examples(40)
@given(PACES, st.lists(st.integers(0, 3), max_size=20))
def test_the_stretch_is_what_a_motion_took_beyond_its_path(
    paces: list[tuple[float, int]], missed: list[int]
) -> None:
    executor = holding()
    executor.submit("a", fast(2.0))
    executor.slowed_by = (ReasonCode.LOOKAHEAD_COLLISION,)
    shares = [share for share, ticks in paces for _ in range(ticks)]
    now = start = 5.0
    executor.goal(now)
    ended = []
    for tick in range(4000):
        executor.pace = shares[tick] if tick < len(shares) else 1.0
        skipped = missed[tick] if tick < len(missed) else 0
        now += PERIOD * (1 + skipped)
        executor.goal(now, skipped)
        running = executor.stretch
        ended = executor.outcomes()
        if ended:
            break
        assert running is not None and running.added >= 0.0
    (outcome,) = ended
    stretch = outcome.stretch
    assert stretch is not None
    assert stretch.duration == pytest.approx(fast(2.0).time[-1])
    assert now - start + PERIOD == pytest.approx(stretch.duration + stretch.added, abs=1.01 * PERIOD)
    skipped = sum(missed[: tick + 1])
    slowed = any(share < 1.0 for share in shares[: tick + 1])
    reasons = set(stretch.reasons)
    assert reasons or not stretch.added
    assert reasons >= ({ReasonCode.LOOP_LATE} if sum(missed[:tick]) else set())
    assert reasons <= {ReasonCode.LOOP_LATE} or slowed
    assert ReasonCode.LOOKAHEAD_COLLISION in reasons or stretch.added <= skipped * PERIOD + 1e-6


def test_a_late_tick_is_not_a_missed_one() -> None:
    executor = holding()
    executor.submit("a", smooth([0.1, 0.0], 0.5))
    executor.goal(1.0)
    executor.goal(1.0 + 1.9 * PERIOD)
    assert executor.stretch is not None
    assert (executor.stretch.added, executor.stretch.reasons) == (0.0, ())
    executor.goal(1.0 + 5.0 * PERIOD, 2)
    assert (executor.stretch.added, executor.stretch.reasons) == (2 * PERIOD, (ReasonCode.LOOP_LATE,))


def test_what_was_lost_before_a_motion_began_is_not_its_own() -> None:
    executor = holding()
    executor.goal(1.0)
    executor.submit("a", smooth([0.1, 0.0], 0.2))
    executor.goal(2.0, 99)
    assert executor.stretch is not None
    assert (executor.stretch.added, executor.stretch.reasons) == (0.0, ())
    executor.submit("b", smooth([0.0, 0.0], 0.5), start_in=0.4)
    executor.stop()
    assert [outcome.stretch is None for outcome in executor.outcomes()] == [False, True]
