"""Writable goals: a step within the velocity limit, and finite numbers (STEP_LIMIT, NaN)."""

from itertools import product
from math import inf, nan

import numpy as np
import pytest

from tests.support.gate_rig import at_rest, limits
from tests.support.guard_rig import FINE, LIMITS, PERIOD, STEP, TINY, N, facts, joints, judge, reading
from twind.robot.finding import ReasonCode
from twind.robot.modes import Mode, Motion, RobotState
from twind.safety.guard import BusTraffic, Guard, GuardThresholds, Reaction


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(
    ("step", "fits"), [(STEP - TINY, True), (STEP, True), (STEP + TINY, False), (1.0, False)]
)
def test_step_limit_a_goal_steps_no_further_than_the_velocity_limit(
    side: float, step: float, fits: bool
) -> None:
    for mode, motion in product(Mode, Motion):
        judgement = judge(mode=mode, motion=motion, setpoint_age=0.0, goal=at_rest([0.0, side * step, 0.0]))
        if fits:
            assert judgement == FINE
        else:
            assert (judgement.reaction, judgement.goal_refused) == (Reaction.HOLD, True)
            (finding,) = judgement.findings
            assert (finding.code, finding.joint, finding.value) == (
                ReasonCode.STEP_LIMIT,
                1,
                pytest.approx(step),
            )
            assert finding.bound == pytest.approx(STEP)


@pytest.mark.parametrize(("full", "cause"), [(0, "an internal error"), (1, "the port was full")])
def test_step_limit_a_goal_that_the_port_had_no_room_for_is_no_bug(full: int, cause: str) -> None:
    guard = Guard(LIMITS, buses=("left", "right"))
    traffic = (BusTraffic(), BusTraffic(full=full))
    judgement = guard.judge(facts(goal=at_rest([0.0, 2 * STEP, 0.0]), traffic=traffic))
    assert judgement.goal_refused
    assert cause in judgement.findings[0].message


def test_step_limit_the_reported_step_counts_from_the_last_goal() -> None:
    (finding,) = judge(previous=joints(0.0, 0.5, 0.0), goal=at_rest([0.0, 1.5, 0.0])).findings
    assert (finding.code, finding.joint, finding.value) == (ReasonCode.STEP_LIMIT, 1, 1.0)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_step_limit_a_jump_of_all_joints_past_their_hard_limits_is_refused(side: float) -> None:
    judgement = judge(goal=at_rest([side * 5.0] * N))
    assert (judgement.reaction, judgement.goal_refused) == (Reaction.HOLD, True)
    assert [finding.code for finding in judgement.findings] == [ReasonCode.STEP_LIMIT]


@pytest.mark.parametrize("lateness", [0.0, 0.5])
def test_step_limit_exactly_the_largest_step_is_written_in_a_late_tick_too(lateness: float) -> None:
    largest = LIMITS.velocity[1] * PERIOD + 1e-9
    for step, fits in ((largest, True), (np.nextafter(largest, 1.0), False)):
        judgement = judge(lateness=lateness, goal=at_rest([0.0, step, 0.0]))
        assert judgement.goal_refused is not fits


def test_step_limit_the_bound_follows_the_period() -> None:
    guard = Guard(LIMITS)
    goal = at_rest([0.0, STEP, 0.0])
    assert guard.judge(facts(goal=goal)) == FINE
    assert guard.judge(facts(goal=goal, period=0.005)).goal_refused


@pytest.mark.parametrize(("more", "fits"), [(1e-9, True), (1.05e-9, False)])
def test_step_limit_a_rounding_of_a_billionth_is_let_through(more: float, fits: bool) -> None:
    goal = np.zeros(N)
    goal[1] = LIMITS.velocity[1] * PERIOD + more
    assert judge(goal=at_rest(list(goal))).goal_refused is not fits


@pytest.mark.parametrize("period", [0.001, 0.05, 0.5])
def test_step_limit_a_goal_steps_by_the_period_from_the_first_tick_on(period: float) -> None:
    assert judge(period=period, goal=at_rest([0.0, 3.9 * period, 0.0])) == FINE
    assert judge(period=period, goal=at_rest([0.0, 4.1 * period, 0.0])).goal_refused


@pytest.mark.parametrize(("step", "fits"), [(3.9, True), (4.1, False)])
def test_step_limit_at_one_tick_per_second_a_goal_steps_by_a_second(step: float, fits: bool) -> None:
    judgement = judge(
        mode=Mode.SIM, period=1.0, previous=joints(0.0, -1.9, 0.0), goal=at_rest([0.0, step - 1.9, 0.0])
    )
    assert judgement.goal_refused is not fits


def test_step_limit_a_first_goal_has_nothing_to_step_from() -> None:
    assert judge(previous=None, goal=at_rest([1.0, 1.0, 1.0])) == FINE


def test_step_limit_a_last_goal_that_is_no_number_refuses_the_next() -> None:
    assert judge(previous=joints(0.0, 0.0, nan)).goal_refused


@pytest.mark.parametrize("bad", [nan, inf, -inf])
def test_a_goal_that_is_no_number_is_refused_in_every_mode(bad: float) -> None:
    for mode, previous in product(Mode, [np.zeros(N), None]):
        judgement = judge(mode=mode, goal=at_rest([0.0, 0.0, bad]), previous=previous)
        assert (judgement.reaction, judgement.goal_refused) == (Reaction.HOLD, True)
        assert [(finding.code, finding.joint) for finding in judgement.findings] == [
            (ReasonCode.NONFINITE, 2)
        ]


@pytest.mark.parametrize("state", RobotState)
def test_w5_where_nothing_may_be_written_a_goal_inhibits(state: RobotState) -> None:
    closed = (RobotState.IDENTIFYING, RobotState.CONNECTED, RobotState.CALIBRATING, RobotState.INHIBITED)
    judgement = judge(state=state, motion=Motion.IDLE)
    assert (judgement.reaction is Reaction.INHIBIT) is (state in closed)
    assert judgement.goal_refused is (state in closed)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_out_of_limit_a_joint_past_its_limit_gives_no_finding_for_one_at_its_limit(side: float) -> None:
    judgement = judge(
        measured=reading([side * 2.0, side * 2.01, 0.0]),
        previous=side * joints(2.01, 2.01, 0.0),
        goal=at_rest([side * 2.011, side * 2.0, 0.0]),
    )
    assert judgement == FINE


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_out_of_limit_every_joint_past_its_limit_is_reported(side: float) -> None:
    there = np.full(N, side * 2.1)
    judgement = judge(measured=reading(list(there)), previous=there, goal=at_rest(list(there)))
    found = [(finding.code, finding.joint) for finding in judgement.findings]
    assert found == [(ReasonCode.OUT_OF_LIMIT, joint) for joint in range(N)]


def test_state_stale_a_late_joint_gives_no_finding_for_one_just_in_time() -> None:
    judgement = judge(measured=reading(age=[0.05, 0.03, 0.0], time=10.0), now=10.0)
    assert [(finding.code, finding.joint) for finding in judgement.findings] == [(ReasonCode.STATE_STALE, 0)]


# ------------------------------------------------------------------------------------ a goal past hard limits

FENCE = 2.05 + 0.0087


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(
    ("goal", "fits"), [(2.05, True), (FENCE - TINY, True), (FENCE + TINY, False), (5.0, False)]
)
def test_out_of_limit_a_first_goal_past_the_hard_limit_is_withheld(
    side: float, goal: float, fits: bool
) -> None:
    judgement = judge(previous=None, goal=at_rest([0.0, side * goal, 0.0]))
    if fits:
        assert judgement == FINE
    else:
        assert (judgement.reaction, judgement.goal_refused) == (Reaction.HOLD, True)
        (finding,) = judgement.findings
        assert (finding.code, finding.joint, finding.value) == (ReasonCode.OUT_OF_LIMIT, 1, side * goal)
        assert finding.bound == side * 2.05
    for mode in (Mode.SIM, Mode.MIRROR):
        assert judge(mode=mode, previous=None, goal=at_rest([0.0, side * goal, 0.0])) == FINE


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(("step", "fits"), [(-STEP, True), (0.0, True), (TINY, False), (STEP, False)])
def test_out_of_limit_from_past_the_hard_limit_a_goal_may_only_lead_inwards(
    side: float, step: float, fits: bool
) -> None:
    before = joints(0.0, 0.0, side * 2.2)
    goal = joints(0.0, 0.0, side * (2.2 + step))
    assert judge(previous=before, goal=at_rest(list(goal))).goal_refused is not fits


def test_out_of_limit_a_goal_that_creeps_past_the_hard_limit_is_withheld() -> None:
    """Each step fits the velocity limit."""
    guard = Guard(LIMITS)
    place = 2.0
    for _ in range(100):
        goal = place + 0.5 * STEP
        if guard.judge(facts(previous=joints(0.0, 0.0, place), goal=at_rest([0.0, 0.0, goal]))).goal_refused:
            break
        place = goal
    assert FENCE - 0.5 * STEP <= place <= FENCE


UNEVEN = limits(N, lower=-1.0, upper=3.0)  # hard -1.05 and 3.05, around 1.0


@pytest.mark.parametrize(
    ("goal", "bound"),
    [
        (3.05 + 0.0087 - TINY, None),
        (3.05 + 0.0087 + TINY, 3.05),
        (-1.05 - 0.0087 + TINY, None),
        (-1.05 - 0.0087 - TINY, -1.05),
    ],
)
def test_out_of_limit_each_hard_limit_of_an_uneven_range_counts(goal: float, bound: float | None) -> None:
    judgement = Guard(UNEVEN).judge(facts(previous=None, goal=at_rest([0.0, goal, 0.0])))
    assert judgement.goal_refused is (bound is not None)
    found = [(finding.joint, finding.value, finding.bound) for finding in judgement.findings]
    assert found == ([] if bound is None else [(1, goal, bound)])


@pytest.mark.parametrize(("before", "outwards"), [(3.2, 1.0), (-1.2, -1.0)])
@pytest.mark.parametrize(("step", "fits"), [(-STEP, True), (0.0, True), (TINY, False), (STEP, False)])
def test_out_of_limit_past_either_end_of_an_uneven_range_a_goal_may_only_lead_inwards(
    before: float, outwards: float, step: float, fits: bool
) -> None:
    goal = at_rest([0.0, 0.0, before + outwards * step])
    judgement = Guard(UNEVEN).judge(facts(previous=joints(0.0, 0.0, before), goal=goal))
    assert judgement.goal_refused is not fits


@pytest.mark.parametrize(("more", "fits"), [(1e-9, True), (1.05e-9, False)])
def test_out_of_limit_past_the_hard_limit_a_rounding_of_a_billionth_is_let_through(
    more: float, fits: bool
) -> None:
    judgement = judge(previous=joints(0.0, 0.0, 2.2), goal=at_rest([0.0, 0.0, 2.2 + more]))
    assert judgement.goal_refused is not fits


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("first", [1.0, 2.5])
def test_out_of_limit_the_first_joint_past_its_bound_is_named_and_no_other(side: float, first: float) -> None:
    """The hard limit is 2.25 rad, and a goal may be 0.25 rad past it."""
    guard = Guard(limits(N, hard_upper=2.25, hard_lower=-2.25), GuardThresholds(beyond_hard=0.25))
    goal = at_rest([side * first, side * 2.75, side * 3.0])
    judgement = guard.judge(facts(previous=None, goal=goal))
    assert judgement.goal_refused
    found = [(finding.code, finding.joint, finding.value) for finding in judgement.findings]
    assert found == [(ReasonCode.OUT_OF_LIMIT, 1, side * 2.75)]
