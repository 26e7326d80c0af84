"""Joints that are left limp: what arming asks of the devices for the others, and what it refuses."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.support.gate_rig import ratings
from tests.support.procedure_rig import BROKEN, PLACE, ProcedureRig, granted
from twind.loop.ipc.call_outcome import CallRefusal, CallReply
from twind.loop.procedures import arming
from twind.loop.procedures.procedure_runner import Priority
from twind.robot.arrays import Bools
from twind.robot.finding import Finding, ReasonCode

HIP, KNEE, TOE = np.eye(3, dtype=np.bool_)
NOBODY = np.zeros(3, np.bool_)


@pytest.fixture
def rig() -> ProcedureRig:
    return ProcedureRig()


def armed(rig: ProcedureRig, limp: Bools) -> Any:
    """Arm all joints but `limp`; the outcome."""
    assert rig.own(Priority.ARM, lambda: arming.arm(rig, granted, (), limp, rig.clock.now()))
    rig.until_done()
    [outcome] = rig.outcomes
    return outcome


def refused(rig: ProcedureRig, limp: Bools) -> list[Finding]:
    """The findings of an arming that is refused and asks the devices for nothing."""
    outcome = armed(rig, limp)
    assert isinstance(outcome, CallRefusal), outcome
    assert "prepare" not in rig.hardware.log and "torque True" not in rig.hardware.log
    return list(outcome.findings)


def test_only_the_others_get_goals_and_torque_and_the_reply_names_them(rig: ProcedureRig) -> None:
    assert armed(rig, TOE) == CallReply({"joints": [0, 1]})
    assert rig.hardware.among.tolist() == [True, True, False]
    assert rig.torque.held.tolist() == [True, True, False]
    assert rig.torque.limp.tolist() == [False, False, True]


def test_a_limp_joint_may_be_wherever_a_hand_holds_it_and_move(rig: ProcedureRig) -> None:
    """Past its hard limit, further than a standstill allows while goals are written, and on at torque-on."""
    place = PLACE + np.array([0.0, 0.0, 3.0])

    def swing() -> None:
        place[2] += 0.1
        rig.read(position=place.copy())

    rig.watched = swing
    assert armed(rig, TOE) == CallReply({"joints": [0, 1]})
    assert rig.hardware.log.count("write goals") == 1


def test_a_limp_joint_is_read_all_the_same(rig: ProcedureRig) -> None:
    rig.read(position=np.array([0.0, 0.0, np.nan]))
    [finding] = refused(rig, TOE)
    assert (finding.code, finding.joint) == (ReasonCode.HW_DISCONNECTED, 2)


def test_a_limp_joint_without_a_watchdog_is_not_warned_of(rig: ProcedureRig) -> None:
    """It drives nowhere if the daemon dies."""
    rig.robot.joints.unwatched = (1, 2)
    outcome = armed(rig, TOE)
    assert [warning.joint for warning in outcome.parameters["warnings"]] == [1]


def test_a_limp_servo_may_read_another_turn_at_torque_on(rig: ProcedureRig) -> None:
    rig.robot.joints.turns = SimpleNamespace(
        known=np.ones(3, np.bool_), falls=np.ones(3, np.bool_), whole=np.full(3, 4096), begin=np.zeros(3, int)
    )
    rig.hardware.readings.shift = np.array([0, 0, 4096])
    assert armed(rig, TOE) == CallReply({"joints": [0, 1]})


@pytest.mark.parametrize(("support", "refuses"), [("gantry", False), ("fixed", False), ("free", True)])
def test_a_robot_that_stands_freely_keeps_its_legs(support: str, refuses: bool) -> None:
    rig = ProcedureRig(support=support)
    rated = replace(ratings(3), leg=HIP | KNEE)
    rig.robot.description = replace(rig.robot.description, ratings=rated)
    if not refuses:
        assert isinstance(armed(rig, KNEE | TOE), CallReply)
        return
    [finding] = refused(rig, KNEE | TOE)
    assert (finding.code, finding.joint) == (ReasonCode.JOINT_LIMP, 1)
    assert "needs torque in its legs" in finding.message


@pytest.mark.parametrize(
    ("limp", "wrong"), [(NOBODY, []), (HIP, []), (KNEE, [1]), (TOE, [2]), (KNEE | TOE, []), (HIP | TOE, [2])]
)
def test_joints_that_share_motors_are_limp_together_or_not_at_all(
    rig: ProcedureRig, limp: Bools, wrong: list[int]
) -> None:
    rig.robot.joints.transmission_groups = (np.array([1, 2]),)
    if not wrong:
        assert isinstance(armed(rig, limp), CallReply)
        return
    findings = refused(rig, limp)
    assert [(finding.code, finding.joint) for finding in findings] == [
        (ReasonCode.JOINT_LIMP, joint) for joint in wrong
    ]
    assert "shares motors" in findings[0].message


@pytest.mark.parametrize(
    ("torque", "refuses"), [((0, 0, 0), False), ((-1, -1, 0), False), ((0, 0, -1), True)]
)
def test_a_joint_stays_limp_only_if_its_torque_was_read(
    rig: ProcedureRig, torque: tuple[int, ...], refuses: bool
) -> None:
    rig.found(torque)
    if not refuses:
        assert isinstance(armed(rig, TOE), CallReply)
        return
    [finding] = refused(rig, TOE)
    assert (finding.code, finding.joint, finding.value, finding.bound) == (
        ReasonCode.ARM_FAILED,
        2,
        -1.0,
        0.0,
    )
    assert "its torque was not read" in finding.message


@pytest.mark.parametrize(("torque", "refuses"), [((1, 1, 0), False), ((1, 1, 1), True), ((1, 0, 0), True)])
def test_torque_that_was_found_on_is_taken_over_where_just_the_limp_joints_have_none(
    rig: ProcedureRig, torque: tuple[int, ...], refuses: bool
) -> None:
    rig.found(torque)
    if refuses:
        assert [finding.code for finding in refused(rig, TOE)] == [ReasonCode.ARM_FAILED]
    else:
        assert armed(rig, TOE) == CallReply({"joints": [0, 1]})


@pytest.mark.parametrize("step", ["prepare", "write goals", "torque True"])
def test_a_failed_arming_leaves_no_joint_marked_as_limp(rig: ProcedureRig, step: str) -> None:
    rig.hardware.failing[step] = BROKEN
    assert isinstance(armed(rig, TOE), CallRefusal)
    assert not rig.torque.partial and not rig.torque.armed
