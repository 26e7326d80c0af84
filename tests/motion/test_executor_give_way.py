"""The executor gives in to a hand, yields to a load, and says from what the coming ticks follow."""

from collections.abc import Sequence
from dataclasses import replace
from math import nan
from typing import Any

import numpy as np
import pytest

from tests.support.executor_rig import LIMITS, PERIOD, holding, only, phases, reading, run, smooth
from tests.support.gate_rig import at_rest, path
from twind.motion.goal_conditions import without_past
from twind.motion.stop_profiles import CompliantFollower, LimitedFollower, StopRamp
from twind.motion.trajectory_executor import TrajectoryExecutor
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Motion
from twind.robot.trajectory import Reference

WHY = (Finding(ReasonCode.FOLLOW_ERR, message="pushed"),)


def stream(executor: TrajectoryExecutor, joints: list[int], place: float) -> None:
    assert executor.setpoint(np.array(joints), np.full(len(joints), place), None, 10.0) is None


def wait(executor: TrajectoryExecutor) -> None:
    assert executor.submit("later", smooth([1.0, 1.0]), start_in=1.0) is None


def move(executor: TrajectoryExecutor) -> None:
    executor.submit("a", smooth([1.0, 1.0]))
    run(executor, 0.3)


# ---------------------------------------------------------------------------------------------- give in


def test_an_idle_executor_neither_gives_in_nor_yields() -> None:
    executor = TrajectoryExecutor(LIMITS, PERIOD)
    executor.give_in([0], np.zeros(2))
    executor.yield_to(np.zeros(2), 1.0)
    assert (executor.motion, executor.plan, executor.goal(0.0)) == (Motion.IDLE, None, None)


def test_a_joint_that_was_pushed_is_held_there_and_the_others_as_commanded() -> None:
    executor = holding([0.2, -0.2])
    executor.give_in([0], np.array([0.3, 0.9]))
    assert run(executor, 1.0)[-1].position == pytest.approx([0.3, -0.2])


def test_a_motion_that_gives_in_is_aborted_with_the_reason_and_brakes() -> None:
    executor = holding()
    move(executor)
    before = executor.reference
    assert before is not None
    executor.give_in([0], np.array([0.1, 0.1]), WHY)
    (ended,) = executor.outcomes()
    assert (ended.id, ended.phase, ended.findings) == ("a", "aborted", WHY)
    after = run(executor, 2.0)[-1].position
    assert after[0] == pytest.approx(0.1)
    speed = before.velocity[1]
    assert after[1] == pytest.approx(before.position[1] + speed**2 / 40.0, abs=0.02), "its braking distance"


@pytest.mark.parametrize("start", [lambda it: stream(it, [1], 0.4), wait, move])
def test_what_is_under_way_ends_when_a_joint_gives_in_a_second_time(start: Any) -> None:
    executor = holding()
    executor.give_in([0], np.array([0.5, 0.0]))
    run(executor, 0.05)
    start(executor)
    executor.give_in([0], np.array([0.2, 0.0]))
    assert executor.motion is Motion.HOLDING
    assert executor.stream is None
    assert run(executor, 1.0)[-1].position[0] == pytest.approx(0.2)


def test_a_joint_on_its_way_goes_on_to_its_earlier_place_and_the_load_pushes_it_no_further() -> None:
    executor = holding()
    executor.give_in([0], np.array([0.5, 0.0]))
    run(executor, 0.05)
    executor.give_in([0, 1], np.array([0.9, -0.3]))
    executor.give_in([1], np.array([0.0, -0.8]))
    assert run(executor, 1.0)[-1].position == pytest.approx([0.5, -0.3])


def test_the_place_of_a_hand_beyond_the_hard_limits_is_not_commanded() -> None:
    executor = holding()
    executor.give_in([0, 1], np.array([9.0, -9.0]))
    assert run(executor, 3.0)[-1].position == pytest.approx([2.05, -2.05])


def test_a_joint_whose_place_is_unknown_rests_where_it_was_commanded_until_it_is_known() -> None:
    executor = holding([0.2, 0.2])
    executor.give_in([0], np.array([nan, 0.2]))
    assert run(executor, 0.5)[-1].position == pytest.approx([0.2, 0.2])
    follower = CompliantFollower(at_rest([0.2, 0.2]), LIMITS, PERIOD)
    follower.aim_at(np.array([True, False]), np.array([nan, 0.5]))
    assert follower.joints.tolist() == [False, False]
    follower.aim_at(np.array([True, False]), np.array([0.3, 0.5]))
    assert follower.joints.tolist() == [True, False]
    assert follower.target == pytest.approx([0.3, 0.2])
    follower.aim_at(np.array([False, True]), np.array([0.3, 0.5]))
    assert follower.joints.tolist() == [True, True]


# ------------------------------------------------------------------------------------------------ yield


def test_a_robot_that_yields_follows_the_load_no_faster_than_asked() -> None:
    executor = holding()
    move(executor)
    executor.yield_to(np.array([1.0, nan]), 0.5)
    assert phases(executor) == [("a", "aborted")]
    speeds = [each.velocity[0] for each in run(executor, 1.0)]
    assert max(speeds[60:]) == pytest.approx(0.5)
    for _ in range(100):
        executor.yield_to(np.array([-1.0, nan]), 0.5)
        executor.goal(0.0)
    reference = executor.reference
    assert reference is not None
    assert reference.velocity[0] == pytest.approx(-0.5)


def test_a_robot_yields_again_after_a_stop() -> None:
    executor = holding()
    executor.yield_to(np.array([0.5, 0.5]), 0.5)
    run(executor, 0.2)
    executor.stop()
    run(executor, 0.2)
    executor.yield_to(np.array([-0.2, 0.5]), 0.5)
    assert run(executor, 3.0)[-1].position == pytest.approx([-0.2, 0.5])


def test_a_robot_that_yields_keeps_one_follower_and_no_goal() -> None:
    executor = holding()
    executor.yield_to(np.array([0.5, 0.5]), 0.5)
    plan = executor.plan
    executor.yield_to(np.array([0.4, 0.5]), 0.5)
    assert plan is not None
    assert executor.plan is not None
    assert executor.plan.floor is plan.floor
    wait(executor)
    executor.stop()
    executor.yield_to(np.array([0.3, 0.5]), 0.5)
    assert executor.plan.floor is not plan.floor


def test_a_follower_that_has_arrived_is_a_hold_again() -> None:
    executor = holding()
    executor.give_in([0], np.array([0.1, 0.0]))
    run(executor, 1.0)
    assert executor.plan is not None
    assert isinstance(executor.plan.floor, StopRamp)


# ------------------------------------------------------------------------------------------------- plan


def test_the_plan_names_what_the_coming_ticks_follow_from() -> None:
    executor = holding()
    move(executor)
    plan = executor.plan
    assert plan is not None
    assert plan.reference is executor.reference
    assert plan.layers == tuple(executor.layers)
    assert (plan.changing, plan.stream, plan.pace) == (False, None, 1.0)
    executor.pace = 0.5
    assert executor.plan is not None
    assert (executor.plan.changing, executor.plan.pace) == (True, 0.5)
    executor.pace = 1.0
    stream(executor, [0, 1], 0.2)
    assert executor.plan is not None
    assert executor.plan.changing
    assert executor.plan.stream is executor.stream


def test_the_pace_of_motions_is_at_most_their_own_and_they_catch_up_slowly() -> None:
    executor = holding()
    move(executor)
    executor.pace = 7.0
    assert (executor.pace, executor.slowed) == (1.0, False)
    executor.pace = 0.95
    assert (executor.pace, executor.slowed) == (0.95, True)
    executor.pace = 0.2
    run(executor, 0.1)
    executor.pace = 1.0
    executor.goal(0.0)
    assert executor.slowed, "its speed has not come back yet"


# ------------------------------------------------------------------------------- goals that wait or end


def test_an_idle_executor_has_no_reference() -> None:
    executor = holding()
    executor.idle()
    assert (executor.motion, executor.reference, executor.plan) == (Motion.IDLE, None, None)


def test_a_goal_that_never_began_ends_with_nothing_done() -> None:
    executor = holding()
    wait(executor)
    executor.submit("last", smooth([0.0, 0.0]), start_in=3.0)
    assert executor.progress() == ("later", 0.0)
    executor.stop()
    assert [(each.fraction, each.stretch) for each in executor.outcomes()] == [(0.0, None), (0.0, None)]


def test_a_goal_for_the_same_start_replaces_the_one_that_waits() -> None:
    executor = holding()
    wait(executor)
    executor.submit("other", smooth([0.0, 0.0]), start_in=1.0)
    assert (phases(executor), executor.waiting) == ([("later", "replaced")], 1)


def test_a_goal_whose_time_is_over_is_refused_with_the_reason() -> None:
    executor = holding()
    refused = executor.submit("old", smooth([1.0, 1.0]), start_in=-5.0)
    assert refused is not None
    assert executor.waiting == 0


def test_a_start_in_the_past_joins_the_path_where_it_is_now() -> None:
    late = holding()
    given = path([0.2, 0.6, 1.0], [[0.1, 0.1], [0.3, 0.3], [0.4, 0.4]])
    late.submit("a", given, start_in=-0.3)
    left = without_past(given, -0.3)
    assert not isinstance(left, Finding)
    now = holding()
    now.submit("a", left)
    for ours, theirs in zip(run(late, 0.8), run(now, 0.8), strict=True):
        assert ours.position == pytest.approx(theirs.position, abs=1e-12)


def test_the_reference_ahead_is_before_what_a_goal_of_that_time_changes() -> None:
    executor = holding()
    executor.submit("a", path([1.0], [[0.5, 0.5]], [[0.0, 0.0]]), start_in=0.5)
    assert executor.ahead(0.5).acceleration.tolist() == [0.0, 0.0]


def test_the_reference_ahead_of_a_stop_is_on_its_ramp() -> None:
    executor = holding()
    executor.submit("a", smooth([1.5, 1.5]))
    run(executor, 0.4)
    executor.stop()
    run(executor, 0.03)
    predicted = executor.ahead(0.04)
    track = run(executor, 0.04)
    assert predicted.position == pytest.approx(track[-1].position, abs=1e-12)
    assert np.abs(track[-1].velocity).max() > 0.1


def test_a_joint_that_a_goal_does_not_name_goes_on_braking() -> None:
    executor = holding()
    executor.submit("a", smooth([1.5, 1.5]))
    run(executor, 0.4)
    executor.stop()
    ramp = StopRamp(executor.reference or at_rest([0.0, 0.0]), LIMITS, PERIOD)
    executor.submit("b", only(0, smooth([1.0, 0.0])))
    for reference in run(executor, 0.1):
        assert reference.position[1] == pytest.approx(ramp.step().position[1], abs=1e-12)


def test_a_reference_that_is_no_number_brakes_from_where_the_robot_is() -> None:
    class NoCurve:
        duration = 1.0

        def sample(self, t: float) -> Reference:
            return Reference(*(np.full(2, nan) for _ in range(3)))

    executor = holding()
    move(executor)
    before = executor.reference
    assert before is not None
    executor.layers = [replace(executor.layers[0], curve=NoCurve())]  # type: ignore[arg-type]
    first = run(executor, PERIOD)[0]
    assert first.position == pytest.approx(before.position + before.velocity * PERIOD, abs=2e-3)
    assert [each.findings[0].code for each in executor.outcomes()] == [ReasonCode.INTERNAL]


def test_a_goal_without_tolerances_is_not_judged_by_what_is_measured() -> None:
    executor = holding()
    move(executor)
    executor.observe(reading([9.0, 9.0]))
    assert (executor.motion, executor.outcomes()) == (Motion.ACTIVE, [])


# ----------------------------------------------------------------------------------------------- stream


def test_setpoints_of_the_same_joints_are_one_stream_and_a_further_joint_widens_it() -> None:
    executor = holding()
    move(executor)
    stream(executor, [0], 0.2)
    assert [layer.joints.tolist() for layer in executor.layers] == [[False, True]]
    first = executor.stream
    stream(executor, [0], 0.3)
    assert executor.stream is first
    stream(executor, [0, 1], 0.3)
    assert executor.stream is not first
    assert executor.stream is not None
    assert executor.stream.joints.all()
    assert executor.layers == []
    wide = executor.stream
    stream(executor, [1], 0.1)
    assert executor.stream is wide


def test_a_stream_that_is_widened_goes_on_to_its_setpoints_at_their_speed() -> None:
    executor = holding()
    assert executor.setpoint(np.array([0]), np.array([0.4]), np.array([0.1]), 10.0) is None
    stream(executor, [1], 0.3)
    assert run(executor, 1.0)[-1].position == pytest.approx([0.5, 0.3], abs=0.005)


def test_a_joint_that_joins_a_stream_has_no_speed_of_its_own() -> None:
    executor = holding()
    stream(executor, [0], 0.0)
    assert executor.setpoint(np.array([1]), np.array([0.0]), np.array([0.0]), 10.0) is None
    assert run(executor, 1.0)[-1].position == pytest.approx([0.0, 0.0])


def test_a_fence_ends_a_stream_where_it_is_until_the_fence_is_gone() -> None:
    executor = holding()
    stream(executor, [0], 0.5)
    executor.fence = (np.full(2, -0.2), np.full(2, 0.3))
    assert run(executor, 1.0)[-1].position == pytest.approx([0.3, 0.0])
    executor.fence = None
    assert run(executor, 1.0)[-1].position == pytest.approx([0.5, 0.0])


# ------------------------------------------------------------------------------------------ the follower


def follower(position: Sequence[float], velocity: Sequence[float]) -> LimitedFollower:
    n = len(position)
    return LimitedFollower(Reference(np.array(position), np.array(velocity), np.zeros(n)), LIMITS, PERIOD)


def braking_speed(distance: float) -> float:
    """Fastest speed from which whole steps of braking, by 0.2 rad/s each, stop within `distance`."""
    gain = 20.0 * PERIOD
    return min(distance / (n * PERIOD) + 0.5 * (n - 1) * gain for n in range(1, 200))


@pytest.mark.parametrize("distance", [0.0005, 0.00198, 0.00202, 0.0059, 0.0061, 0.0119, 0.0121, 0.05, 0.2])
def test_a_follower_is_as_fast_as_whole_steps_of_braking_allow(distance: float) -> None:
    fastest = braking_speed(distance)
    one = follower([0.0, 0.0], [fastest, -fastest])
    one.set_target(np.array([distance, -distance]), np.zeros(2))
    assert one.step().velocity == pytest.approx([fastest, -fastest], rel=1e-9)


def test_a_follower_says_how_far_behind_it_is_and_may_be() -> None:
    one = follower([0.2, 0.2], [2.0, 2.0])
    one.set_target(np.array([1.2, -0.8]), np.array([0.5, 0.5]))
    away, stopping, fastest = one.lag()
    assert away == pytest.approx([1.0, 1.0])
    assert stopping == pytest.approx([1.5**2 / 40.0, 0.0]), "only what closes needs a way to stop"
    assert fastest == pytest.approx([4.0, 4.0])
    one.step(0.5)
    assert one.lag()[2] == pytest.approx([2.0, 2.0])
    assert one.acceleration.tolist() == [20.0, 20.0]
    one = follower([0.2, 0.2], [2.0, 2.0])
    one.set_target(np.array([0.2, 0.2]), np.zeros(2))
    assert one.lag()[1].tolist() == [0.0, 0.0], "it is at its target, and may not be behind"


def test_a_follower_foretells_its_next_step_at_the_same_share_without_taking_it() -> None:
    one = follower([0.0, 0.0], [1.0, 0.0])
    assert one.ahead(0.0).velocity.tolist() == [1.0, 0.0]
    one.set_target(np.array([1.5, -1.5]), np.array([0.1, 0.0]))
    for share in (1.0, 0.1, 1.0):
        foretold = one.onwards(share)
        assert one.onwards(share).position.tolist() == foretold.position.tolist()
        assert one.step(share).position.tolist() == foretold.position.tolist()
    assert one.onwards().velocity.tolist() == one.step().velocity.tolist()


def test_a_follower_runs_at_the_velocity_limit() -> None:
    one = follower([-1.9, 1.9], [4.0, -4.0])
    one.set_target(np.array([1.9, -1.9]), np.zeros(2))
    assert one.step().velocity == pytest.approx([4.0, -4.0])
    assert one.onwards().velocity == pytest.approx([4.0, -4.0])


@pytest.mark.parametrize("moving", [([1.0, 0.0], [0.0, 0.0]), ([0.0, 0.0], [0.0, 0.3])])
def test_a_follower_with_one_joint_or_one_target_in_motion_has_not_arrived(moving: Any) -> None:
    velocity, drift = moving
    one = follower([0.0, 0.0], velocity)
    one.set_target(np.zeros(2), np.array(drift))
    assert not one.resting
    one = follower([0.0, 0.0], [0.0, 0.0])
    assert one.resting


@pytest.mark.parametrize(("off", "arrived"), [(1e-12, True), (1.05e-12, False)])
def test_a_follower_has_arrived_within_rounding(off: float, arrived: bool) -> None:
    one = follower([0.0, 0.0], [0.0, 0.0])
    one.set_target(np.array([off, 0.0]), np.zeros(2))
    assert one.resting is arrived
    one = follower([0.0, 0.0], [off, 0.0])
    one.set_target(np.zeros(2), np.zeros(2))
    assert one.resting is arrived
