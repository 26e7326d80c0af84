"""Every rule of the per-tick gate: dense around its threshold, in every mode and state."""

from dataclasses import replace
from itertools import product
from math import inf, nan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.gate_rig import at_rest
from tests.support.guard_rig import FINE, LIMITS, PERIOD, STEP, TINY, N, codes, facts, joints, judge, reading
from twind.robot.arrays import Floats
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Mode, Motion, RobotState
from twind.safety.contact_rules import ContactRules
from twind.safety.guard import MOVING, REACTING, UNWRITABLE, Guard, GuardDecision, GuardThresholds, Reaction
from twind.safety.guard_types import RuleResult

# --------------------------------------------------------------------------------------------- all well


def test_a_healthy_state_gives_no_finding() -> None:
    assert judge() == FINE


@pytest.mark.parametrize(("mode", "state", "motion"), list(product(Mode, RobotState, Motion)))
def test_a_hold_at_the_last_goal_is_refused_only_where_nothing_may_be_written(
    mode: Mode, state: RobotState, motion: Motion
) -> None:
    judgement = judge(mode=mode, state=state, motion=motion, setpoint_age=0.0)
    if mode is Mode.LIVE and state in UNWRITABLE:
        assert (judgement.reaction, judgement.goal_refused) == (Reaction.INHIBIT, True)
        assert codes(judgement) == [ReasonCode.INTERNAL]
        assert state.value in judgement.findings[0].message
    elif motion is Motion.STREAMING and state in (RobotState.FAULT, RobotState.ESTOP):
        assert judgement.reaction is Reaction.HOLD
        assert codes(judgement) == [
            ReasonCode.ESTOP if state is RobotState.ESTOP else ReasonCode.FAULT_LATCHED
        ]
        assert not judgement.goal_refused
    else:
        assert judgement == FINE


def test_other_parts_of_the_loop_read_the_thresholds_of_the_guard() -> None:
    bounds = GuardThresholds(follow=0.123)
    assert Guard(LIMITS, bounds, support="gantry").bounds is bounds


def test_other_parts_of_the_loop_read_the_follow_bounds_of_the_guard() -> None:
    assert Guard(LIMITS, GuardThresholds(follow=0.123)).follow.tolist() == [0.123] * N


def test_other_parts_of_the_loop_read_the_contact_rules_of_the_guard() -> None:
    contact = ContactRules(np.full(N, 1.0), ["arm"] * N)
    assert Guard(LIMITS, contact=contact).contact is contact
    assert Guard(LIMITS).contact is None


@pytest.mark.parametrize(
    "fenced", [GuardDecision(), RuleResult(Finding(ReasonCode.LEAD_LIMIT, 1))], ids=["decision", "result"]
)
def test_decisions_and_results_with_a_fence_can_be_compared(fenced: GuardDecision | RuleResult) -> None:
    """Two arrays have no single truth value; the finding states what the fence is about."""
    here = replace(fenced, fence=(np.full(N, -1.0), np.full(N, 1.0)))
    there = replace(fenced, fence=(np.full(N, -2.0), np.full(N, 2.0)))
    assert here == there


def test_nothing_to_write_is_always_fine() -> None:
    for mode, state in product(Mode, RobotState):
        assert judge(mode=mode, state=state, motion=Motion.IDLE, goal=None, previous=None) == FINE


def test_reactions_are_ordered_by_severity() -> None:
    order = [Reaction.NONE, Reaction.HOLD, Reaction.SETTLE, Reaction.DAMP, Reaction.INHIBIT]
    assert sorted(Reaction) == order


# ------------------------------------------------------------------------------------------------- LOOP_LATE


@pytest.mark.parametrize(
    ("lateness", "reported"),
    [(0.0, False), (0.002, False), (0.002 + 1e-9, True), (0.5, True), (nan, True), (-1.0, False)],
)
def test_loop_late_a_tick_later_than_two_milliseconds_is_reported(lateness: float, reported: bool) -> None:
    judgement = judge(lateness=lateness)
    assert judgement.reaction is Reaction.NONE
    assert codes(judgement) == ([ReasonCode.LOOP_LATE] if reported else [])


@pytest.mark.parametrize(
    ("rate", "missed", "reaction"),
    [
        (50.0, 4, Reaction.NONE),
        (50.0, 5, Reaction.HOLD),
        (100.0, 5, Reaction.HOLD),
        (500.0, 5, Reaction.NONE),
        (500.0, 24, Reaction.NONE),
        (500.0, 25, Reaction.HOLD),
        (1000.0, 49, Reaction.NONE),
        (1000.0, 50, Reaction.HOLD),
        (nan, 5, Reaction.HOLD),
    ],
)
def test_loop_late_at_a_high_rate_a_few_missed_ticks_cause_no_hold(
    rate: float, missed: int, reaction: Reaction
) -> None:
    found = judge(missed_in_a_row=missed, period=1.0 / rate, goal=None)
    assert found.reaction is reaction
    assert codes(found) == [ReasonCode.LOOP_LATE]
    if reaction:
        assert found.findings[0].bound == pytest.approx(max(5.0, 0.05 * rate) if rate > 0.0 else 5.0)


@pytest.mark.parametrize(
    ("missed", "reaction", "bound"),
    [
        (0, Reaction.NONE, None),
        (1, Reaction.NONE, None),
        (2, Reaction.NONE, 2.0),
        (4, Reaction.NONE, 2.0),
        (5, Reaction.HOLD, 5.0),
        (100, Reaction.HOLD, 5.0),
    ],
)
def test_loop_late_two_missed_ticks_are_reported_and_five_hold(
    missed: int, reaction: Reaction, bound: float | None
) -> None:
    judgement = judge(missed_in_a_row=missed)
    assert judgement.reaction is reaction
    assert [finding.bound for finding in judgement.findings] == ([] if bound is None else [bound])


def test_loop_late_exactly_two_milliseconds_are_in_time_beside_another_finding() -> None:
    assert codes(judge(lateness=0.002, lease_ok=False)) == [ReasonCode.LEASE_LOST]
    late = judge(lateness=0.002 + 1e-9, lease_ok=False)
    assert codes(late) == [ReasonCode.LOOP_LATE, ReasonCode.LEASE_LOST]


@pytest.mark.parametrize(("mode", "reaction"), [(Mode.LIVE, Reaction.HOLD), (Mode.SIM, Reaction.NONE)])
def test_loop_late_missed_ticks_hold_a_robot_and_no_simulation(mode: Mode, reaction: Reaction) -> None:
    judgement = judge(mode=mode, missed_in_a_row=5)
    assert (judgement.reaction, codes(judgement)) == (reaction, [ReasonCode.LOOP_LATE])


def test_a_motion_that_begins_now_would_be_held_for_what_holds_now() -> None:
    guard = Guard(LIMITS)
    guard.judge(facts(measured=reading(age=[0.0, 0.2, 0.0])))
    assert [(finding.code, finding.joint) for finding in guard.holding(0, PERIOD)] == [
        (ReasonCode.STATE_STALE, 1)
    ]
    guard.judge(facts(lease_ok=False))  # of the motion that runs, not of the one that begins
    assert guard.holding(0, PERIOD) == ()
    guard.judge(facts())
    assert guard.holding(4, PERIOD) == ()
    [late] = guard.holding(5, PERIOD)
    assert (late.code, late.value, late.bound) == (ReasonCode.LOOP_LATE, 5.0, 5.0)


def test_what_held_in_an_earlier_tick_holds_no_motion_that_begins_now() -> None:
    guard = Guard(LIMITS)
    guard.judge(facts(measured=reading(age=[0.0, 0.2, 0.0])))
    assert guard.holding(0, PERIOD) != ()
    assert guard.judge(facts()) == FINE
    assert guard.holding(0, PERIOD) == ()


STREAM = {"motion": Motion.STREAMING, "setpoint_age": 0.0}


@pytest.mark.parametrize(
    ("code", "over"),
    [
        (ReasonCode.LOOP_LATE, {"missed_in_a_row": 5}),
        (ReasonCode.ESTOP, {**STREAM, "state": RobotState.ESTOP}),
        (ReasonCode.FAULT_LATCHED, {**STREAM, "state": RobotState.FAULT}),
        (ReasonCode.STREAM_STALE, {**STREAM, "setpoint_age": 0.2}),
        (ReasonCode.LEASE_LOST, {"lease_ok": False}),
        (ReasonCode.NONFINITE, {"goal": at_rest([nan, 0.0, 0.0])}),
        (ReasonCode.STEP_LIMIT, {"goal": at_rest([1.0, 0.0, 0.0])}),
        (ReasonCode.OUT_OF_LIMIT, {"previous": None, "goal": at_rest([2.5, 0.0, 0.0])}),
        (
            ReasonCode.OUT_OF_LIMIT,
            {
                "measured": reading([2.01, 0.0, 0.0]),
                "previous": joints(2.01, 0.0, 0.0),
                "goal": at_rest([2.02, 0.0, 0.0]),
            },
        ),
    ],
)
def test_what_holds_the_motion_that_runs_keeps_no_other_from_beginning(
    code: ReasonCode, over: dict[str, object]
) -> None:
    guard = Guard(LIMITS)
    judgement = guard.judge(facts(**over))
    assert (judgement.reaction, codes(judgement)) == (Reaction.HOLD, [code])
    assert guard.holding(0, PERIOD) == ()


def test_a_warning_keeps_no_motion_from_beginning() -> None:
    guard = Guard(LIMITS)
    assert codes(guard.judge(facts(lateness=0.01))) == [ReasonCode.LOOP_LATE]
    assert guard.holding(0, PERIOD) == ()


# -------------------------------------------------------------------------------- LEASE_LOST and STREAM_STALE


@pytest.mark.parametrize(("mode", "state", "motion"), list(product(Mode, RobotState, Motion)))
def test_lease_lost_without_a_lease_whatever_moves_holds_but_a_way_to_rest(
    mode: Mode, state: RobotState, motion: Motion
) -> None:
    judgement = judge(mode=mode, state=state, motion=motion, lease_ok=False, setpoint_age=0.0)
    lost = motion in MOVING and state not in REACTING
    if mode is Mode.LIVE and state in UNWRITABLE:
        assert judgement.reaction is Reaction.INHIBIT
    else:
        assert (ReasonCode.LEASE_LOST in codes(judgement)) is lost
        assert judgement.reaction >= Reaction.HOLD or not lost
        assert not judgement.latches


@pytest.mark.parametrize(
    ("age", "holds"), [(0.0, False), (0.1, False), (0.1 + 1e-9, True), (1.0, True), (nan, True), (None, True)]
)
def test_stream_stale_a_setpoint_older_than_a_tenth_of_a_second_holds(age: float | None, holds: bool) -> None:
    judgement = judge(motion=Motion.STREAMING, setpoint_age=age)
    assert judgement.reaction is (Reaction.HOLD if holds else Reaction.NONE)
    assert codes(judgement) == ([ReasonCode.STREAM_STALE] if holds else [])


# ------------------------------------------------------------------------------------------------ STATE_STALE


@pytest.mark.parametrize(
    ("age", "bound", "reaction", "latches"),
    [
        (0.03, None, Reaction.NONE, False),
        (0.03 + TINY, 0.03, Reaction.NONE, False),
        (0.1, 0.03, Reaction.NONE, False),
        (0.1 + TINY, 0.1, Reaction.HOLD, False),
        (0.5, 0.1, Reaction.HOLD, False),
        (0.5 + TINY, 0.5, Reaction.SETTLE, True),
        (inf, 0.5, Reaction.SETTLE, True),
        (nan, 0.5, Reaction.SETTLE, True),
    ],
)
@pytest.mark.parametrize("aged_since", [0.0, 0.02])
def test_state_stale_a_joint_without_readings_is_reported_then_held_then_a_fault(
    age: float, bound: float | None, reaction: Reaction, latches: bool, aged_since: float
) -> None:
    """Its age counts at the tick: what it was when read, and what has passed since."""
    measured = reading(age=[0.0, age - aged_since, 0.0], time=0.0)
    measured = replace(measured, age=measured.age - joints(0.0, 0.0, aged_since))
    over = {"now": aged_since, "measured": measured, "status_time": np.full(N, -1.0)}
    judgement = judge(**over)
    assert (judgement.reaction, judgement.latches) == (reaction, latches)
    found = [(finding.code, finding.joint, finding.bound) for finding in judgement.findings]
    assert found == ([] if bound is None else [(ReasonCode.STATE_STALE, 1, bound)])
    for other in ({"mode": Mode.MIRROR}, {"torque_expected": False}):
        elsewhere = judge(**over, **other)
        assert (elsewhere.reaction, elsewhere.latches) == (Reaction.NONE, False)
        assert [finding.bound for finding in elsewhere.findings] == ([] if bound is None else [bound])


def test_state_stale_no_reading_at_all_holds_what_we_hold() -> None:
    judgement = judge(measured=None)
    assert (judgement.reaction, codes(judgement)) == (Reaction.HOLD, [ReasonCode.STATE_STALE])
    assert judge(measured=None, mode=Mode.SIM, state=RobotState.DISCONNECTED, torque_expected=False) == FINE


@pytest.mark.parametrize("state", REACTING)
def test_a_way_to_rest_is_not_cut_short_by_a_hold(state: RobotState) -> None:
    for over in (
        {"measured": reading(age=[0.2, 0.0, 0.0])},
        {"missed_in_a_row": 9},
        {"lease_ok": False},
        {"measured": None},
        {"watchdog": np.array([255, 5, 5], np.int16)},
        {"measured": reading([2.1, 0.0, 0.0]), "previous": joints(2.1, 0.0, 0.0), "goal": None},
    ):
        assert judge(state=state, **over).reaction is Reaction.NONE


@pytest.mark.parametrize("state", [RobotState.ARMED, RobotState.SETTLING, RobotState.FAULT, RobotState.ESTOP])
def test_a_joint_that_stays_silent_settles_whatever_was_under_way(state: RobotState) -> None:
    assert judge(state=state, measured=reading(age=[0.6, 0.0, 0.0])).reaction is Reaction.SETTLE


# ------------------------------------------------------------------------------ RX_SHAPE and WATCHDOG_TRIPPED


def test_rx_shape_dropped_bytes_are_only_reported() -> None:
    judgement = judge(discarded=7)
    assert (judgement.reaction, judgement.latches) == (Reaction.NONE, False)
    assert [(finding.code, finding.value) for finding in judgement.findings] == [(ReasonCode.RX_SHAPE, 7.0)]


@pytest.mark.parametrize(("value", "trips"), [(255, True), (254, False), (5, False), (-1, False)])
def test_watchdog_tripped_a_tripped_watchdog_holds_and_is_latched(value: int, trips: bool) -> None:
    watchdog = np.array([5, 5, value], np.int16)
    judgement = judge(watchdog=watchdog)
    if trips:
        assert (judgement.reaction, judgement.latches) == (Reaction.HOLD, True)
        assert [(finding.code, finding.joint) for finding in judgement.findings] == [
            (ReasonCode.WATCHDOG_TRIPPED, 2)
        ]
    else:
        assert judgement == FINE
    assert judge(watchdog=watchdog, torque_expected=False, motion=Motion.IDLE, goal=None) == FINE
    assert judge(watchdog=watchdog, mode=Mode.MIRROR) == FINE


# -------------------------------------------------------------------------------------------- TORQUE_MISMATCH


def refreshes(readings: list[tuple[float, int]], **over: object) -> list[GuardDecision]:
    """Judgements of ticks in which joint 1's torque was last read at that time, as that."""
    guard = Guard(LIMITS)
    result = []
    for time, value in readings:
        torque = np.array([1, value, 1], np.int8)
        result.append(guard.judge(facts(torque=torque, status_time=joints(time, time, time), **over)))
    return result


@pytest.mark.parametrize("value", [0, -1])
def test_torque_mismatch_torque_that_reads_back_other_twice_in_a_row_is_a_fault(value: int) -> None:
    first, same, second = refreshes([(1.0, value), (1.0, value), (1.05, value)])
    assert first == same == FINE
    limp = Reaction.DAMP if value == 0 else Reaction.SETTLE  # of a robot without support
    assert (second.reaction, second.latches) == (limp, True)
    (finding,) = second.findings
    assert (finding.code, finding.joint, finding.value, finding.bound) == (
        ReasonCode.TORQUE_MISMATCH,
        1,
        float(value),
        1.0,
    )


def test_torque_mismatch_one_wrong_refresh_between_right_ones_is_none() -> None:
    assert refreshes([(1.0, 0), (1.05, 1), (1.1, 0), (1.15, 1)]) == [FINE] * 4


def test_torque_mismatch_each_joint_is_counted_by_its_own_refreshes() -> None:
    guard = Guard(LIMITS)
    off = np.array([0, 0, 1], np.int8)
    for times in (joints(1.0, 1.0, 1.0), joints(1.1, 1.0, 1.0)):
        judgement = guard.judge(facts(torque=off, status_time=times))
    assert [finding.joint for finding in judgement.findings] == [0]


def test_torque_mismatch_what_a_procedure_changes_is_not_judged_and_begins_anew() -> None:
    guard = Guard(LIMITS)

    def read(time: float, settled: bool = True) -> GuardDecision:
        off = np.zeros(N, np.int8)
        when = np.full(N, time)
        return guard.judge(facts(now=time, torque=off, status_time=when, torque_settled=settled))

    for time in (10.0, 10.005, 10.01):
        assert read(time, settled=False) == FINE
    assert read(10.01) == FINE
    assert read(10.015) == FINE
    assert read(10.02).latches


@pytest.mark.parametrize("over", [{"mode": Mode.MIRROR}, {"torque_expected": False}])
def test_torque_mismatch_where_we_hold_nothing_torque_is_not_ours_to_judge(over: dict[str, object]) -> None:
    assert refreshes([(1.0, 0), (1.1, 0), (1.2, 0)], **over) == [FINE] * 3


def test_torque_mismatch_while_settling_it_is_latched_without_a_hold() -> None:
    guard = Guard(LIMITS, support="gantry")
    off = np.array([1, 0, 1], np.int8)
    for time in (1.0, 1.1):
        last = guard.judge(facts(torque=off, status_time=np.full(N, time), state=RobotState.SETTLING))
    assert (last.reaction, last.latches) == (Reaction.NONE, True)


# ----------------------------------------------------------------------------------------------- OUT_OF_LIMIT


HARD = 2.05 + 0.0087


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(
    ("place", "fault"), [(2.05, False), (HARD - TINY, False), (HARD, False), (HARD + TINY, True), (9.0, True)]
)
def test_out_of_limit_a_joint_past_its_hard_limit_is_a_fault(side: float, place: float, fault: bool) -> None:
    there = joints(0.0, 0.0, side * place)
    given = {"measured": reading(list(there)), "previous": there, "goal": at_rest(list(there))}
    judgement = judge(**given)
    assert (judgement.latches, judgement.reaction) == (fault, Reaction.HOLD if fault else Reaction.NONE)
    if fault:
        (finding,) = judgement.findings
        assert (finding.code, finding.joint, finding.value) == (ReasonCode.OUT_OF_LIMIT, 2, side * place)
        assert finding.bound == pytest.approx(side * HARD)
    for other in ({"mode": Mode.MIRROR}, {"torque_expected": False}):
        elsewhere = judge(**given, **other)
        assert (elsewhere.latches, elsewhere.reaction) == (False, Reaction.NONE)
        assert codes(elsewhere) == ([ReasonCode.OUT_OF_LIMIT] if fault else [])


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("motion", Motion)
@pytest.mark.parametrize(
    ("place", "before", "goal", "outward"),
    [
        (2.01, 2.01, 2.01 + 1e-3, True),
        (2.01, 2.01, 2.01, False),
        (2.01, 2.01, 2.01 - 1e-3, False),
        (2.01, 1.99, 2.0, False),  # a goal inside the limits is inwards of the joint
        (2.01, 1.99, 2.0 + TINY, True),
        (2.0, 2.01, 2.011, False),  # not past its limit
        (1.95, 2.01, 2.011, False),
    ],
)
def test_out_of_limit_past_its_limit_a_joint_may_only_be_moved_inwards(
    side: float, motion: Motion, place: float, before: float, goal: float, outward: bool
) -> None:
    judgement = judge(
        motion=motion,
        setpoint_age=0.0,
        measured=reading([side * place, 0.0, 0.0]),
        previous=side * joints(before, 0.0, 0.0),
        goal=at_rest([side * goal, 0.0, 0.0]),
    )
    if outward and motion in MOVING:
        assert (judgement.reaction, judgement.goal_refused, judgement.latches) == (Reaction.HOLD, True, False)
        (finding,) = judgement.findings
        assert (finding.code, finding.joint, finding.bound) == (ReasonCode.OUT_OF_LIMIT, 0, side * 2.0)
    else:  # above all: a stop that still rolls outwards is never refused
        assert judgement == FINE


LIMP = [
    (None, True),
    ([False, False, False], True),
    ([True, True, False], False),
    ([False, False, True], True),
]


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(("limp", "held"), LIMP)
def test_out_of_limit_past_its_limit_a_held_joint_is_moved_inwards_and_a_limp_one_is_free(
    side: float, limp: list[bool] | None, held: bool
) -> None:
    judgement = judge(
        limp=None if limp is None else np.array(limp),
        measured=reading([0.0, side * 2.01, 0.0]),
        previous=side * joints(0.0, 2.01, 0.0),
        goal=at_rest([0.0, side * 2.02, 0.0]),
    )
    assert (judgement.reaction, judgement.goal_refused) == (
        (Reaction.HOLD, True) if held else (Reaction.NONE, False)
    )
    assert [(finding.code, finding.joint) for finding in judgement.findings] == (
        [(ReasonCode.OUT_OF_LIMIT, 1)] if held else []
    )


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(("limp", "held"), LIMP)
def test_out_of_limit_past_its_hard_limit_a_held_joint_is_a_fault_and_a_limp_one_is_reported(
    side: float, limp: list[bool] | None, held: bool
) -> None:
    there = side * joints(0.0, 2.1, 0.0)
    judgement = judge(
        limp=None if limp is None else np.array(limp),
        measured=reading(list(there)),
        previous=there,
        goal=at_rest(there),
    )
    assert (judgement.reaction, judgement.latches) == (
        (Reaction.HOLD, True) if held else (Reaction.NONE, False)
    )
    assert [(finding.code, finding.joint) for finding in judgement.findings] == [(ReasonCode.OUT_OF_LIMIT, 1)]


def test_out_of_limit_before_anything_was_written_there_is_no_outwards() -> None:
    assert judge(measured=reading([2.01, 0.0, 0.0]), previous=None, goal=at_rest([2.02, 0.0, 0.0])) == FINE


# ------------------------------------------------------------------------------------ whatever comes in


numbers = st.one_of(st.floats(-3.0, 3.0), st.sampled_from([nan, inf, -inf, 0.0, 2.0, -2.05]))
rows = st.lists(numbers, min_size=N, max_size=N).map(np.array)


@given(
    goal=st.none() | rows,
    previous=st.none() | rows,
    place=st.none() | rows,
    age=rows,
    now=st.sampled_from([10.0, 10.02, 9.0, nan]),
    mode=st.sampled_from(Mode),
    state=st.sampled_from(RobotState),
    motion=st.sampled_from(Motion),
    lease_ok=st.booleans(),
    lateness=numbers,
    expected=st.booleans(),
)
def test_a_goal_that_leaves_is_finite_and_within_a_step_whatever_else_is_true(
    goal: Floats | None,
    previous: Floats | None,
    place: Floats | None,
    age: Floats,
    now: float,
    mode: Mode,
    state: RobotState,
    motion: Motion,
    lease_ok: bool,
    lateness: float,
    expected: bool,
) -> None:
    judgement = judge(
        goal=None if goal is None else at_rest(goal),
        previous=previous,
        measured=None if place is None else reading(list(place), list(age)),
        now=now,
        mode=mode,
        state=state,
        motion=motion,
        lease_ok=lease_ok,
        lateness=lateness,
        torque_expected=expected,
    )
    if goal is not None and not judgement.goal_refused:
        assert np.isfinite(goal).all()
        assert previous is None or (np.abs(goal - previous) <= STEP + 1e-8).all()
        assert not (mode is Mode.LIVE and state in UNWRITABLE)
    if judgement.goal_refused:
        assert judgement.reaction >= Reaction.HOLD
    if judgement.latches:
        assert judgement.findings
