"""The reaction of all joints to one that fails (STATE_STALE, SERVO_ALERT, TORQUE_MISMATCH), by support."""

from dataclasses import replace
from math import inf

import numpy as np
import pytest

from tests.support.guard_rig import LIMITS, N, codes, facts, reading
from twind.robot.actuator_ratings import ActuatorRatings
from twind.robot.finding import ReasonCode
from twind.robot.modes import RobotState
from twind.safety.guard import Guard, GuardDecision, Reaction

HOLD = Reaction.HOLD
SETTLE = Reaction.SETTLE
DAMP = Reaction.DAMP
NONE = Reaction.NONE
LEGS = replace(
    ActuatorRatings.unknown(N), leg=np.array([True, False, False])
)  # joint 0 alone carries the robot
SUPPORTS = ["fixed", "gantry", "free", "", "swing"]  # what is unknown counts as free


def carried(support: str) -> bool:
    return support in ("fixed", "gantry")


def guard(support: str) -> Guard:
    return Guard(LIMITS, support=support, ratings=LEGS)


def torque(support: str, joint: int, value: int) -> GuardDecision:
    watch = guard(support)
    read = np.ones(N, np.int8)
    read[joint] = value
    for time in (1.0, 1.1):
        last = watch.judge(facts(torque=read, status_time=np.full(N, time)))
    return last


def restart(support: str, joint: int) -> GuardDecision:
    watch = guard(support)
    ticks = np.full(N, 9000, np.int32)
    watch.judge(facts(tick=ticks, health_time=np.full(N, 9.8)))
    again = ticks + 200
    again[joint] = 7
    return watch.judge(facts(tick=again, health_time=np.full(N, 10.0)))


@pytest.mark.parametrize("support", SUPPORTS)
@pytest.mark.parametrize("joint", [0, 1])
def test_torque_that_is_gone_holds_the_others_or_lowers_or_on_a_leg_damps(support: str, joint: int) -> None:
    hurt = DAMP if joint == 0 else SETTLE
    for found, code in (
        (torque(support, joint, 0), ReasonCode.TORQUE_MISMATCH),
        (restart(support, joint), ReasonCode.SERVO_REBOOTED),
    ):
        assert codes(found) == [code]
        assert (found.reaction, found.latches) == (HOLD if carried(support) else hurt, True)


@pytest.mark.parametrize("support", SUPPORTS)
@pytest.mark.parametrize("joint", [0, 1])
def test_a_limp_joint_holds_a_supported_robot_and_settles_another(support: str, joint: int) -> None:
    expected = HOLD if carried(support) else SETTLE
    age = [0.0] * N
    age[joint] = 0.6
    silent = guard(support).judge(facts(measured=reading(age=age)))
    assert (codes(silent), silent.reaction, silent.latches) == ([ReasonCode.STATE_STALE], expected, True)
    alerts = np.zeros(N, np.uint8)
    alerts[joint] = 0x80
    alert = guard(support).judge(facts(alerts=alerts))
    assert (codes(alert), alert.reaction, alert.latches) == ([ReasonCode.SERVO_ALERT], expected, True)
    unknown = torque(support, joint, -1)
    assert (codes(unknown), unknown.reaction) == ([ReasonCode.TORQUE_MISMATCH], expected)


@pytest.mark.parametrize("support", SUPPORTS)
def test_the_whole_chain_silent_is_a_fault_of_all(support: str) -> None:
    found = guard(support).judge(facts(measured=reading(age=[inf, 0.6, 0.51])))
    assert (found.reaction, found.latches) == (HOLD if carried(support) else SETTLE, True)
    assert [finding.joint for finding in found.findings] == [0, 1, 2]


def test_without_ratings_every_joint_is_a_leg() -> None:
    watch = Guard(LIMITS)
    for time in (1.0, 1.1):
        last = watch.judge(facts(torque=np.array([1, 1, 0], np.int8), status_time=np.full(N, time)))
    assert last.reaction is DAMP


@pytest.mark.parametrize("state", [RobotState.SETTLING, RobotState.FAULT, RobotState.ESTOP])
def test_a_supported_robot_on_its_way_down_continues(state: RobotState) -> None:
    found = guard("gantry").judge(facts(state=state, measured=reading(age=[0.6, 0.0, 0.0])))
    assert (found.reaction, found.latches) == (NONE, True)
