"""TIME_GAP: time that passed without us is a fault of an armed robot, and no old goal leaves after it.

And a hold that nobody ends: what stands freely is lowered.
"""

from math import nan

import numpy as np
import pytest

from tests.support.guard_rig import FINE, LIMITS, TINY, codes, facts, reading
from twind.robot.finding import ReasonCode
from twind.robot.modes import Mode, Motion, RobotState
from twind.safety.guard import Guard, GuardDecision, Reaction

PERIOD = 0.01
HOLD = Reaction.HOLD
SETTLE = Reaction.SETTLE
NONE = Reaction.NONE


def after(gap: float, *, slept: float = 0.0, period: float = PERIOD, **over: object) -> GuardDecision:
    """The judgement of a tick that begins `gap` s after the one before it."""
    guard = Guard(LIMITS, support="gantry")
    usual = {"period": period, **over}
    guard.judge(facts(now=10.0, **usual))
    later = 10.0 + gap
    return guard.judge(facts(now=later, measured=reading(time=later), suspended=slept, **usual))


@pytest.mark.parametrize(
    ("gap", "trips"),
    [(0.0, False), (PERIOD, False), (0.06, False), (0.11 - TINY, False), (0.11 + TINY, True), (30.0, True)],
)
def test_a_tick_later_than_the_watchdogs_wait_is_a_fault(gap: float, trips: bool) -> None:
    found = after(gap)
    assert (found.reaction, found.latches) == (Reaction.HOLD if trips else Reaction.NONE, trips)
    assert found.goal_refused is trips  # the last goal again, none that was meant for later
    if trips:
        (finding,) = found.findings
        assert (finding.code, finding.bound) == (ReasonCode.TIME_GAP, 0.1)
        assert finding.value == pytest.approx(gap - PERIOD)
        assert "without a tick" in finding.message


@pytest.mark.parametrize(
    ("slept", "trips"), [(0.0, False), (0.1 - TINY, False), (0.1 + TINY, True), (3600.0, True)]
)
def test_a_machine_that_slept_is_a_fault_though_its_clock_stood_still(slept: float, trips: bool) -> None:
    found = after(PERIOD, slept=slept)
    assert codes(found) == ([ReasonCode.TIME_GAP] if trips else [])
    if trips:
        assert "slept" in found.findings[0].message


def test_as_long_as_the_watchdogs_wait_is_too_long() -> None:
    found = after(0.25, period=0.25, slept=0.1)  # a period that is exact in binary
    assert (codes(found), found.findings[0].value) == ([ReasonCode.TIME_GAP], 0.1)
    assert "slept" in found.findings[0].message


def test_suspended_and_late_time_add_up() -> None:
    found = after(0.06 + PERIOD, slept=0.06)
    assert found.findings[0].value == pytest.approx(0.12)
    assert "without a tick" in found.findings[0].message


def test_suspended_time_counts_since_the_last_tick() -> None:
    guard = Guard(LIMITS, support="gantry")
    for tick in range(20):
        now = 10.0 + tick * PERIOD
        found = guard.judge(facts(now=now, measured=reading(time=now), suspended=0.05 * tick))
        assert codes(found) == []


def test_slept_before_the_first_tick_is_nothing() -> None:
    assert codes(Guard(LIMITS).judge(facts(suspended=3600.0))) == []


@pytest.mark.parametrize("period", [0.001, 0.01, 0.05])
def test_the_period_itself_is_no_gap(period: float) -> None:
    assert after(period, period=period) == FINE
    assert after(period + 0.11, period=period).latches


def test_a_time_that_is_no_number_is_a_gap() -> None:
    assert after(nan).latches


@pytest.mark.parametrize("over", [{"torque_expected": False}, {"mode": Mode.SIM}, {"mode": Mode.MIRROR}])
def test_nothing_is_lost_where_we_hold_nothing(over: dict[str, object]) -> None:
    assert ReasonCode.TIME_GAP not in codes(after(5.0, **over))


def test_an_arming_under_way_ends_by_it() -> None:
    found = after(0.2, state=RobotState.ARMING, torque_expected=False, goal=None)
    assert (codes(found), found.latches, found.goal_refused) == ([ReasonCode.TIME_GAP], True, False)


@pytest.mark.parametrize("state", [RobotState.SETTLING, RobotState.FAULT, RobotState.ESTOP])
def test_a_way_down_goes_on(state: RobotState) -> None:
    found = after(0.2, state=state, torque_settled=False)
    assert (found.reaction, found.latches, found.goal_refused) == (Reaction.NONE, True, False)


# ----------------------------------------------------------------------------- a hold that nobody ends


class Held:
    """A robot that is held, tick by tick of a second."""

    def __init__(self, support: str) -> None:
        self.guard = Guard(LIMITS, support=support)
        self.now = 10.0

    def second(self, **over: object) -> GuardDecision:
        self.now += 1.0
        usual = {"period": 1.0, "now": self.now, "measured": reading(time=self.now)} | over
        return self.guard.judge(facts(**usual))


def test_a_free_robot_that_is_held_for_thirty_seconds_is_lowered() -> None:
    held = Held("free")
    assert held.second(lease_ok=False).reaction is HOLD
    for _ in range(29):
        assert held.second(motion=Motion.HOLDING).reaction is NONE
    last = held.second(motion=Motion.HOLDING)
    assert (last.reaction, last.latches, codes(last)) == (SETTLE, True, [ReasonCode.LEASE_LOST])
    assert (last.findings[0].value, last.findings[0].bound) == (30.0, 30.0)
    assert "30 s" in last.findings[0].message


@pytest.mark.parametrize("support", ["fixed", "gantry"])
def test_a_supported_robot_holds_without_a_time_limit(support: str) -> None:
    held = Held(support)
    held.second(lease_ok=False)
    assert {held.second(motion=Motion.HOLDING).reaction for _ in range(60)} == {NONE}


@pytest.mark.parametrize(
    "over",
    [
        {"motion": Motion.ACTIVE},
        {"motion": Motion.HOLDING, "torque_settled": False},
        {"motion": Motion.HOLDING, "torque_expected": False},
        {"motion": Motion.HOLDING, "mode": Mode.SIM},
    ],
)
def test_the_hold_time_counts_from_the_last_hold_without_a_motion_since(over: dict[str, object]) -> None:
    held = Held("free")
    held.second(lease_ok=False)
    for _ in range(20):
        held.second(motion=Motion.HOLDING)
    held.second(**over)
    held.second(lease_ok=False)
    for _ in range(29):
        assert held.second(motion=Motion.HOLDING).reaction is NONE
    assert held.second(motion=Motion.HOLDING).reaction is SETTLE


def test_a_robot_that_was_armed_and_left_alone_is_not_lowered() -> None:
    held = Held("free")
    assert {held.second(motion=Motion.HOLDING).reaction for _ in range(60)} == {NONE}


def test_missed_ticks_during_a_hold_lower_no_robot() -> None:
    held = Held("free")
    assert held.second(motion=Motion.HOLDING, missed_in_a_row=5).reaction is HOLD
    assert {held.second(motion=Motion.HOLDING).reaction for _ in range(60)} == {NONE}
    assert held.second(motion=Motion.ACTIVE, missed_in_a_row=5).reaction is HOLD
    assert held.second(motion=Motion.HOLDING, missed_in_a_row=5).reaction is HOLD
    assert [held.second(motion=Motion.HOLDING).reaction for _ in range(29)] == [NONE] * 28 + [SETTLE]


@pytest.mark.parametrize("over", [{"motion": Motion.HOLDING}, {"torque_expected": False}])
def test_missed_ticks_after_another_state_lower_no_robot(over: dict[str, object]) -> None:
    held = Held("free")
    held.second(**over)
    assert held.second(motion=Motion.HOLDING, missed_in_a_row=5).reaction is HOLD
    assert {held.second(motion=Motion.HOLDING).reaction for _ in range(60)} == {NONE}


def test_a_motion_that_ended_before_the_torque_was_off_lowers_no_robot_that_is_armed_again() -> None:
    held = Held("free")
    assert held.second(motion=Motion.ACTIVE, missed_in_a_row=5).reaction is HOLD
    held.second(torque_expected=False)
    assert held.second(motion=Motion.HOLDING, missed_in_a_row=5).reaction is HOLD
    assert {held.second(motion=Motion.HOLDING).reaction for _ in range(60)} == {NONE}


@pytest.mark.parametrize("motion", [Motion.ACTIVE, Motion.HOLDING])
def test_a_reported_finding_without_reaction_is_no_hold(motion: Motion) -> None:
    held = Held("free")
    assert {held.second(motion=motion, lateness=0.01).reaction for _ in range(60)} == {NONE}


def test_a_fault_while_it_holds_anyway_is_lowered() -> None:
    held = Held("free")
    tripped = held.second(motion=Motion.HOLDING, watchdog=np.array([255, 5, 5], np.int16))
    assert (tripped.reaction, tripped.latches) == (HOLD, True)
    rest = {"motion": Motion.HOLDING, "state": RobotState.FAULT}
    assert [held.second(**rest).reaction for _ in range(30)] == [NONE] * 29 + [SETTLE]


def test_a_hold_whose_cause_lasts_is_lowered_too() -> None:
    held = Held("free")
    found = [
        held.second(motion=Motion.HOLDING, measured=reading(age=[0.2, 0.0, 0.0], time=held.now + 1.0))
        for _ in range(31)
    ]
    assert [one.reaction for one in found] == [HOLD] * 30 + [SETTLE]
    assert found[-1].findings[0].bound == 30.0
