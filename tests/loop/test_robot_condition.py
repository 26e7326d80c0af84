"""Mode, state and latches: each change is reported, and a latch keeps its first finding."""

import pytest

from tests.support.procedure_rig import ProcedureRig
from twind.loop.procedures.robot_condition import RobotCondition
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Mode, RobotState
from twind.safety.state_machine import RobotEvent

FAR = Finding(ReasonCode.FOLLOW_ERR, 1, message="far")
STOP = Finding(ReasonCode.ESTOP, message="stop")


@pytest.fixture
def rig() -> ProcedureRig:
    rig = ProcedureRig()
    rig.reports.urgent = False
    return rig


def test_a_daemon_begins_disconnected_with_nothing_latched(rig: ProcedureRig) -> None:
    condition = RobotCondition(Mode.MIRROR, rig.reports)
    assert condition.mode is Mode.MIRROR
    assert condition.state is RobotState.DISCONNECTED
    assert (condition.latched, condition.identified, condition.cause, dict(condition.latches)) == (
        False,
        False,
        "",
        {},
    )
    assert (condition.unreachable, condition.stop_wanted, condition.finished) == (None, False, False)


def test_a_change_is_reported_at_once_with_its_cause(rig: ProcedureRig) -> None:
    rig.condition.change(RobotEvent.FAULT, stop="hold")
    assert rig.condition.state is RobotState.FAULT and rig.condition.latched
    assert rig.condition.identified
    assert rig.reports.urgent
    [event] = rig.book.events
    assert (event.level, event.code, event.before, event.cause, event.stop) == (
        "info",
        "fault",
        "connected",
        "fault",
        "hold",
    )
    assert event.message == "connected → fault (fault)"


def test_an_event_that_changes_nothing_is_not_reported(rig: ProcedureRig) -> None:
    rig.condition.change(RobotEvent.SETTLED)
    assert rig.book.events == [] and not rig.reports.urgent


def test_an_event_that_the_state_does_not_allow_is_refused_or_left_out(rig: ProcedureRig) -> None:
    with pytest.raises(RuntimeError):
        rig.condition.change(RobotEvent.ARMED)
    rig.condition.change_if(RobotEvent.ARMED)
    assert rig.condition.state is RobotState.CONNECTED
    rig.condition.change_if(RobotEvent.ARM)
    assert rig.condition.state is RobotState.ARMING


def test_the_first_finding_of_a_code_stays_latched(rig: ProcedureRig) -> None:
    rig.condition.latch(FAR)
    assert rig.reports.urgent
    rig.reports.urgent = False
    other = Finding(ReasonCode.FOLLOW_ERR, 2, value=1.0)
    rig.condition.latch(other)
    assert rig.condition.latches == {FAR.code: FAR} and not rig.reports.urgent


def test_the_same_finding_with_a_value_replaces_one_without(rig: ProcedureRig) -> None:
    rig.condition.latch(FAR)
    measured = Finding(ReasonCode.FOLLOW_ERR, 1, value=0.7)
    rig.condition.latch(measured)
    assert rig.condition.latches[FAR.code] is measured
    rig.condition.latch(Finding(ReasonCode.FOLLOW_ERR, 1, value=0.9))
    assert rig.condition.latches[FAR.code] is measured


def test_the_cause_is_the_first_that_was_latched(rig: ProcedureRig) -> None:
    rig.condition.latch(FAR)
    rig.condition.latch(STOP)
    assert rig.condition.cause == "FOLLOW_ERR: far"
    rig.condition.acknowledge(["FOLLOW_ERR", "INTERNAL"])
    assert list(rig.condition.latches) == [ReasonCode.ESTOP]
    rig.condition.acknowledge([ReasonCode.ESTOP])
    assert rig.condition.cause == ""


def test_latches_are_read_only_from_outside(rig: ProcedureRig) -> None:
    with pytest.raises(TypeError):
        rig.condition.latches[FAR.code] = FAR  # type: ignore[index]
