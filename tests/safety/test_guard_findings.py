"""Reports of the guard: once while a condition lasts, and a latch until it is latched."""

from dataclasses import replace
from math import inf, nan

import numpy as np
import pytest

from tests.support.gate_rig import at_rest
from tests.support.guard_rig import FINE, LIMITS, PERIOD, STEP, N, codes, facts, joints, judge, reading
from twind.robot.actuator_ratings import ActuatorRatings
from twind.robot.finding import ReasonCode
from twind.robot.modes import Mode, RobotState
from twind.safety.guard import Guard, GuardDecision, GuardThresholds, Reaction
from twind.safety.guard_types import ClearanceAhead

# --------------------------------------------------------------------------------------- what is told


def ticks(guard: Guard, count: int, start: float = 10.0, **over: object) -> list[GuardDecision]:
    return [
        guard.judge(facts(now=start + tick * PERIOD, measured=reading(time=start + tick * PERIOD), **over))
        for tick in range(count)
    ]


def test_a_lasting_condition_is_reported_once_and_keeps_its_reaction() -> None:
    judgements = ticks(Guard(LIMITS), 500, lease_ok=False)
    assert [len(judgement.findings) for judgement in judgements] == [1] + [0] * 499
    assert {judgement.reaction for judgement in judgements} == {Reaction.HOLD}


@pytest.mark.parametrize(
    ("bad", "times"), [({"lateness": 0.01}, 1), ({"missed_in_a_row": 5}, 3)], ids=["warned of", "holds"]
)
def test_a_recurring_condition_is_reported_after_a_second_and_a_warning_after_ten(
    bad: dict[str, object], times: int
) -> None:
    guard = Guard(LIMITS)
    told = 0
    for tick in range(300):  # every second tick is bad
        told += len(ticks(guard, 1, 10.0 + tick * PERIOD, **(bad if tick % 2 else {}))[0].findings)
    assert told == times
    assert ticks(guard, 1000, 13.0) == [FINE] * 1000
    assert len(ticks(guard, 1, 23.0, **bad)[0].findings) == 1


@pytest.mark.parametrize(
    ("bad", "later", "again"),
    [
        ({"lateness": 0.01}, 9.5, 0),
        ({"lateness": 0.01}, 10.5, 1),
        ({"missed_in_a_row": 5}, 0.95, 0),
        ({"missed_in_a_row": 5}, 1.0, 1),
        ({"missed_in_a_row": 5}, 1.05, 1),
    ],
)
def test_a_recurring_condition_is_reported_only_after_its_quiet_time(
    bad: dict[str, object], later: float, again: int
) -> None:
    guard = Guard(LIMITS)
    assert len(ticks(guard, 1, **bad)[0].findings) == 1
    assert ticks(guard, 1, 10.0 + later - PERIOD, period=later) == [FINE]
    assert len(ticks(guard, 1, 10.0 + later, **bad)[0].findings) == again


def test_a_lasting_condition_is_reported_once_however_slow_the_ticks() -> None:
    guard = Guard(LIMITS)
    found = [ticks(guard, 1, 10.0 + 20.0 * count, period=20.0, lateness=0.01)[0] for count in range(4)]
    assert [len(one.findings) for one in found] == [1, 0, 0, 0]


def test_a_reaction_names_causes_already_reported() -> None:
    guard = Guard(LIMITS)
    first, again = ticks(guard, 2, lease_ok=False)
    assert (first.findings, again.findings) == (first.causes, ())
    assert again.causes == first.causes != ()
    assert guard.judge(facts(lateness=0.01)).causes == ()  # no reaction


def test_a_latching_condition_of_an_inhibited_robot_is_reported_once() -> None:
    tripped = np.array([255, 5, 5], np.int16)
    judgements = ticks(Guard(LIMITS), 50, state=RobotState.INHIBITED, goal=None, watchdog=tripped)
    assert [len(judgement.findings) for judgement in judgements] == [1] + [0] * 49


def test_a_worse_level_is_reported_at_once() -> None:
    guard = Guard(LIMITS)
    found = []
    for tick in range(60):
        now = 10.0 + tick * PERIOD
        state = reading(age=[0.0, tick * PERIOD, 0.0], time=now)
        found += guard.judge(facts(mode=Mode.MIRROR, now=now, measured=state)).findings
    assert [finding.bound for finding in found] == [0.03, 0.1, 0.5]


def test_a_robot_that_is_watched_without_its_servos_does_not_flood_the_log() -> None:
    guard = Guard(LIMITS)
    count = 0
    for tick in range(1000):
        now = 10.0 + tick * PERIOD
        state = reading([nan] * N, [inf] * N, now)
        count += len(guard.judge(facts(mode=Mode.MIRROR, now=now, measured=state, discarded=3)).findings)
    assert count == N + 1


def test_a_latching_finding_is_reported_alone_until_it_is_latched() -> None:
    guard = Guard(LIMITS)
    watchdog = np.array([255, 5, 5], np.int16)
    for _ in range(3):
        judgement = guard.judge(facts(watchdog=watchdog, lateness=0.01, discarded=1))
        assert (judgement.latches, codes(judgement)) == (True, [ReasonCode.WATCHDOG_TRIPPED])
    latched = guard.judge(facts(watchdog=watchdog, lateness=0.01, discarded=1, state=RobotState.FAULT))
    assert (latched.latches, codes(latched)) == (False, [ReasonCode.LOOP_LATE, ReasonCode.RX_SHAPE])


@pytest.mark.parametrize("state", [RobotState.FAULT, RobotState.ESTOP])
def test_a_second_fault_is_latched_beside_the_first(state: RobotState) -> None:
    guard = Guard(LIMITS)
    watchdog = np.array([255, 5, 5], np.int16)
    there = {"watchdog": watchdog, "previous": joints(0.0, 2.1, 0.0), "goal": at_rest([0.0, 2.1, 0.0])}
    guard.judge(facts(**there, measured=reading([0.0, 2.05, 0.0])))
    both = {**there, "measured": reading([0.0, 2.1, 0.0]), "state": state}
    first = guard.judge(facts(**both))
    second = guard.judge(facts(**both))
    assert (first.latches, codes(first)) == (True, [ReasonCode.OUT_OF_LIMIT])
    assert (second.latches, second.findings) == (False, ())


def test_the_hardest_reaction_counts_and_names_its_cause() -> None:
    judgement = judge(
        lease_ok=False, measured=reading(age=[0.0, 0.9, 0.2]), watchdog=np.array([255, 5, 5], np.int16)
    )
    assert judgement.reaction is Reaction.SETTLE
    found = {(finding.code, finding.joint) for finding in judgement.findings}
    assert found == {(ReasonCode.STATE_STALE, 1), (ReasonCode.WATCHDOG_TRIPPED, 0)}
    assert [(finding.code, finding.joint) for finding in judgement.causes] == [(ReasonCode.STATE_STALE, 1)]
    inhibited = Guard(LIMITS)
    for _ in range(3):
        judgement = inhibited.judge(facts(state=RobotState.CONNECTED, torque_expected=False, lease_ok=False))
        assert (judgement.reaction, codes(judgement)) == (Reaction.INHIBIT, [ReasonCode.INTERNAL])


def test_the_slowest_pace_counts() -> None:
    near = ClearanceAhead(0.006, 0.1, ("a", "b"), 0.002, 0.010)
    assert judge(outlook=near, lateness=0.01).pace == pytest.approx(0.5)


def test_a_latch_that_comes_again_is_no_mere_warning() -> None:
    guard = Guard(LIMITS)
    tripped = {"watchdog": np.array([255, 5, 5], np.int16), "state": RobotState.FAULT}
    assert len(ticks(guard, 1, **tripped)[0].findings) == 1
    assert ticks(guard, 1, 12.0, period=2.0, state=RobotState.FAULT) == [FINE]
    again = ticks(guard, 1, 12.01, **tripped)[0]
    assert (codes(again), again.latches, again.reaction) == (
        [ReasonCode.WATCHDOG_TRIPPED],
        True,
        Reaction.NONE,
    )


def test_thresholds_can_be_other_ones() -> None:
    strict = GuardThresholds(late=0.0, missed_hold=1, missed_for=0.01, disagreements=1)
    guard = Guard(LIMITS, strict)
    assert codes(guard.judge(facts())) == [ReasonCode.LOOP_LATE]
    assert guard.judge(facts(missed_in_a_row=1)).reaction is Reaction.HOLD
    off = np.array([1, 0, 1], np.int8)
    assert guard.judge(facts(torque=off, status_time=np.full(N, 11.0))).latches


# ------------------------------------------------------------------------------------------ new limits


def test_replaced_limits_apply_from_the_next_tick_and_reported_conditions_are_kept() -> None:
    guard = Guard(LIMITS)
    place = [0.0, 2.0, 0.0]
    there = facts(measured=reading(place), goal=at_rest(place), previous=np.array(place))
    assert guard.judge(there) == FINE
    late = facts(lateness=0.01)
    assert codes(guard.judge(late)) == [ReasonCode.LOOP_LATE]
    upper = LIMITS.upper - 0.5
    hard = LIMITS.hard_upper - 0.5
    slower = replace(LIMITS, upper=upper, hard_upper=hard, velocity=LIMITS.velocity / 2)
    guard.limit(slower, ActuatorRatings.unknown(N))
    assert codes(guard.judge(late)) == [], "told already"
    assert codes(guard.judge(there)) == [ReasonCode.OUT_OF_LIMIT]
    step = facts(goal=at_rest([0.0, 0.75 * STEP, 0.0]))
    assert ReasonCode.STEP_LIMIT in codes(guard.judge(step))
    assert judge(goal=at_rest([0.0, 0.75 * STEP, 0.0])) == FINE, "by the limits of before"


def test_missed_ticks_hold_a_motion_after_new_limits_too() -> None:
    guard = Guard(LIMITS)
    guard.limit(LIMITS, ActuatorRatings.unknown(N))
    assert guard.holding(4, PERIOD) == ()
    assert [finding.code for finding in guard.holding(5, PERIOD)] == [ReasonCode.LOOP_LATE]
