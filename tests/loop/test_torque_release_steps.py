"""Disarm, fault and e-stop, step by step, on scripted buses."""

from contextlib import suppress
from typing import Any

import numpy as np
import pytest

from tests.support.gate_rig import path
from tests.support.procedure_rig import BROKEN, PERIOD, PLACE, REST, SILENT, WHY, ProcedureRig
from twind.loop.ipc.call_outcome import CallFailure, CallReply
from twind.loop.procedures.lowering import SettleProfile
from twind.loop.procedures.procedure_runner import Priority
from twind.loop.procedures.torque_release import STOPS
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Mode, Motion
from twind_drivers.bus import BusError

OFF = ["hold False", "cut 0", "cut 1", "torque False"]
ESTOP = Finding(ReasonCode.ESTOP, message="e-stop (settle)")
WHOLE = SettleProfile(whole=True)


@pytest.fixture
def rig() -> ProcedureRig:
    rig = ProcedureRig()
    rig.hold()
    return rig


def release(rig: ProcedureRig, why: Finding = WHY, **options: Any) -> None:
    rig.run(rig.release.release(why, **options))


def ended_goals(rig: ProcedureRig) -> list[tuple[str, tuple[Finding, ...]]]:
    """Phase and findings of each motion that ended, the way to the rest pose left out."""
    return [(goal.phase, tuple(goal.findings)) for goal in rig.executor.outcomes() if goal.id != "settle"]


def moving(rig: ProcedureRig) -> None:
    """A motion is under way."""
    assert rig.executor.submit("wave", path([2.0], PLACE + 0.3)) is None
    rig.tick()
    assert rig.executor.motion is Motion.ACTIVE


# --------------------------------------------------------------------------------------------- release


def test_a_held_robot_is_lowered_then_torque_goes_off(rig: ProcedureRig) -> None:
    release(rig)
    assert rig.requests() == ["read goals", *OFF]
    assert rig.robot.measured.position == pytest.approx(REST, abs=0.02)
    assert not rig.torque.armed and not rig.torque.unconfirmed


def test_the_queue_is_emptied_first_and_a_motion_ends_with_the_reason(rig: ProcedureRig) -> None:
    moving(rig)
    body = rig.release.release(WHY)
    next(body)
    assert rig.hardware.log == ["clear"]
    assert ended_goals(rig) == [("aborted", (WHY,))]


def test_a_robot_that_does_not_come_to_rest_is_damped_before_torque_goes_off(rig: ProcedureRig) -> None:
    rig.executor.idle()
    release(rig)
    assert rig.requests() == ["damp", *OFF]
    assert rig.codes() == ["SETTLE", "DAMP"]


def test_a_robot_without_torque_is_switched_off_at_once() -> None:
    rig = ProcedureRig()
    begun = rig.clock.now()
    release(rig)
    assert rig.requests() == OFF
    assert rig.clock.now() - begun < 3 * PERIOD


@pytest.mark.parametrize("level", STOPS)
def test_after_a_cut_torque_goes_off_and_nothing_is_driven(level: str) -> None:
    rig = ProcedureRig()
    rig.found()
    rig.torque.latch_stop(level)
    release(rig)
    assert (rig.requests() == OFF) is (level == "cut")


def test_an_inhibited_robot_is_not_lowered(rig: ProcedureRig) -> None:
    rig.torque.inhibit()
    release(rig)
    assert rig.requests() == OFF


@pytest.mark.parametrize("whole", [False, True])
def test_an_error_on_the_way_never_leaves_torque_of_this_daemon_on(rig: ProcedureRig, whole: bool) -> None:
    rig.hardware.slow.watchdog[0] = 255  # prepared anew
    rig.hardware.failing["prepare"] = BROKEN
    release(rig, profile=SettleProfile(whole=whole))
    assert rig.requests() == ["prepare", *OFF]
    [event] = rig.book.events
    assert (event.level, event.code) == ("error", "BUS_ERRORS")
    assert event.message == "the way to the rest pose was cut short: the bus is broken"


def test_torque_that_was_found_on_stays_where_the_whole_robot_is_wanted_and_a_device_fails() -> None:
    rig = ProcedureRig()
    rig.found()
    rig.hardware.failing["prepare"] = SILENT
    with pytest.raises(BusError):
        release(rig, profile=WHOLE)
    assert rig.requests() == ["prepare"]
    assert rig.book.events == []


def test_torque_that_was_found_on_goes_off_after_an_error_where_the_whole_is_not_needed() -> None:
    rig = ProcedureRig()
    rig.found()
    rig.hardware.failing["prepare"] = BROKEN
    release(rig)
    assert rig.requests() == ["prepare", *OFF]


def fails(*_args: Any, **_options: Any) -> Any:
    raise ZeroDivisionError


@pytest.mark.parametrize("broken", ["stop", "submit"])
@pytest.mark.parametrize("whole", [False, True])
def test_an_exception_on_the_way_damps_the_robot_and_torque_goes_off(
    rig: ProcedureRig, monkeypatch: pytest.MonkeyPatch, broken: str, whole: bool
) -> None:
    monkeypatch.setattr(rig.executor, broken, fails)
    release(rig, profile=SettleProfile(whole=whole))
    assert [request for request in rig.requests() if request != "read goals"] == ["damp", *OFF]
    assert not rig.torque.armed and not rig.torque.unconfirmed
    assert {event.message for event in rig.book.events if event.code == "INTERNAL"} == {"ZeroDivisionError()"}
    assert ReasonCode.INTERNAL in rig.condition.latches


def test_an_exception_in_damping_too_does_not_keep_torque_on(
    rig: ProcedureRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rig.executor, "submit", fails)
    monkeypatch.setattr(rig.hardware, "damp", lambda: {}["damp"])
    release(rig)
    assert rig.requests()[-len(OFF) :] == OFF
    assert [event.message for event in rig.book.events if event.code == "INTERNAL"] == [
        "ZeroDivisionError()",
        "KeyError('damp')",
    ]


def test_after_an_exception_a_robot_without_torque_is_not_damped(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = ProcedureRig()
    monkeypatch.setattr(rig.executor, "stop", fails)
    release(rig)
    assert rig.requests() == OFF


def test_after_an_exception_an_inhibited_robot_is_not_damped(
    rig: ProcedureRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig.torque.inhibit()
    monkeypatch.setattr(rig.executor, "stop", fails)
    release(rig)
    assert rig.requests() == OFF


def test_torque_that_was_found_on_stays_after_an_exception_where_the_whole_robot_is_wanted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rig = ProcedureRig()
    rig.found()
    monkeypatch.setattr(rig.hardware, "prepare", fails)
    with pytest.raises(ZeroDivisionError):
        release(rig, profile=WHOLE)
    assert rig.requests() == []
    release(rig)
    assert rig.requests() == ["damp", *OFF], "where it is not, torque goes off"


@pytest.mark.parametrize("level", STOPS)
def test_an_exception_at_its_first_step_does_not_keep_an_estop_from_torque_off(
    rig: ProcedureRig, monkeypatch: pytest.MonkeyPatch, level: str
) -> None:
    monkeypatch.setattr(rig.executor, "stop", fails)
    rig.condition.latch(ESTOP)
    rig.release.stop(level)
    for _ in range(2000):
        if rig.procedures.rank is None:
            break
        with suppress(ZeroDivisionError):
            rig.tick()
    assert rig.requests()[-len(OFF) :] == OFF
    assert not rig.torque.armed and not rig.torque.unconfirmed


def test_a_joint_whose_turn_is_not_determined_is_waited_for() -> None:
    rig = ProcedureRig()
    rig.found()
    rig.verified.unjudged = np.array([True, False, False])
    begun = rig.clock.now()
    rig.own(Priority.FAULT, lambda: rig.release.fault())
    while "prepare" not in rig.hardware.log:
        rig.tick()
    assert rig.clock.now() - begun == pytest.approx(0.5, abs=3 * PERIOD)


def test_a_way_that_takes_long_asks_the_service_manager_for_time(rig: ProcedureRig) -> None:
    release(rig, profile=SettleProfile(way=8.0, within=0.5))
    assert rig.extended and rig.extended[0] > 10.0


# --------------------------------------------------------------------------------------------- disarm


def disarmed(rig: ProcedureRig) -> Any:
    rig.own(Priority.DISARM, rig.release.disarm)
    rig.until_done()
    [outcome] = rig.outcomes
    return outcome


def test_a_disarm_lowers_the_robot_and_answers_with_its_state(rig: ProcedureRig) -> None:
    moving(rig)
    assert disarmed(rig) == CallReply({"state": "connected"})
    assert [event.code for event in rig.book.events] == ["settling", "connected"]
    [(phase, [reason])] = ended_goals(rig)
    assert (phase, reason.code, reason.message) == ("aborted", ReasonCode.NOT_ARMED, "the robot was disarmed")


def test_a_disarm_of_a_robot_without_torque_does_nothing() -> None:
    rig = ProcedureRig()
    assert disarmed(rig) == CallReply({"state": "connected"})
    assert rig.hardware.log == [] and rig.book.events == []


def test_a_disarm_that_a_device_does_not_confirm_names_it_and_the_robot_counts_as_settled(
    rig: ProcedureRig,
) -> None:
    rig.hardware.failing["torque False"] = [SILENT] * 1000
    outcome = disarmed(rig)
    message = (
        f"torque off is not confirmed: {SILENT} (toe); torque is on: `twindctl disarm` again, "
        "or switch the power off"
    )
    assert outcome == CallFailure("BusFailed", {"bus": "", "message": message})
    assert rig.condition.state == "connected"


@pytest.mark.parametrize("energised", [False, True])
@pytest.mark.parametrize(("trouble", "why"), [("unplugged", "unplugged"), ("", "the bus is not open")])
def test_a_disarm_with_a_closed_bus_does_not_claim_that_its_torque_is_off(
    energised: bool, trouble: str, why: str
) -> None:
    rig = ProcedureRig()
    if energised:
        rig.hold()
    rig.hardware.ports[1].reader = None
    rig.hardware.ports[1].trouble = trouble
    expected = f"{why}; whether torque is on there is not known"
    assert disarmed(rig) == CallFailure("BusFailed", {"bus": "upper", "message": expected})


def test_of_two_closed_buses_a_disarm_names_the_first() -> None:
    rig = ProcedureRig()
    for port in rig.hardware.ports:
        port.reader = None
        port.trouble = f"{port.name} unplugged"
    outcome = disarmed(rig)
    assert outcome.parameters["bus"] == "lower"
    assert outcome.parameters["message"].startswith("lower unplugged")


def test_in_another_mode_a_closed_bus_is_no_fault() -> None:
    rig = ProcedureRig()
    rig.condition.mode = Mode.SIM
    rig.hardware.ports[1].reader = None
    assert isinstance(disarmed(rig), CallReply)


def test_a_disarm_that_is_ended_by_force_is_answered_with_the_latched_cause(rig: ProcedureRig) -> None:
    rig.own(Priority.DISARM, rig.release.disarm)
    rig.ticks(20)
    rig.condition.latch(ESTOP)
    rig.release.stop("settle")
    [outcome] = rig.outcomes
    assert outcome == CallFailure("Busy", {"what": "disarming was ended by ESTOP: e-stop (settle)"})
    rig.until_done()
    assert rig.hardware.log.count("torque False") == 1


# --------------------------------------------------------------------------------------------- fault


@pytest.mark.parametrize("latched", [False, True])
@pytest.mark.parametrize("why", [(), (WHY,)])
def test_a_fault_lowers_the_robot_and_its_motion_ends_with_the_cause(
    rig: ProcedureRig, latched: bool, why: tuple[Finding, ...]
) -> None:
    moving(rig)
    if latched:
        rig.condition.latch(ESTOP)
    rig.own(Priority.FAULT, lambda: rig.release.fault(why))
    rig.until_done()
    [(phase, [reason])] = ended_goals(rig)
    expected = WHY.code if why else ReasonCode.ESTOP if latched else ReasonCode.FAULT_LATCHED
    assert (phase, reason.code) == ("aborted", expected)
    assert [event.code for event in rig.book.events] == ["settling", "connected"]
    assert rig.requests() == ["read goals", *OFF]
    assert rig.outcomes == [None]


def test_a_fault_whose_torque_off_stays_unconfirmed_is_reported(rig: ProcedureRig) -> None:
    rig.hardware.failing["torque False"] = [SILENT] * 1000
    rig.own(Priority.FAULT, rig.release.fault)
    rig.until_done()
    assert rig.codes() == ["settling", "TORQUE_MISMATCH", "connected"]


# --------------------------------------------------------------------------------------------- e-stop


def stop(rig: ProcedureRig, level: str = "settle") -> None:
    rig.condition.latch(ESTOP)
    rig.release.stop(level)


def test_an_estop_brakes_lowers_and_switches_off(rig: ProcedureRig) -> None:
    moving(rig)
    stop(rig)
    assert rig.procedures.rank is Priority.ESTOP
    assert ended_goals(rig) == [("aborted", (ESTOP,))]
    rig.until_done()
    assert rig.requests() == ["read goals", *OFF]
    [event] = rig.book.events
    assert (event.code, event.stop) == ("estop", "settle")
    assert rig.torque.stop_level == "settle" and rig.torque.stop_begun


def test_an_estop_that_cuts_switches_off_at_once(rig: ProcedureRig) -> None:
    moving(rig)
    stop(rig, "cut")
    assert rig.hardware.log == ["clear", *OFF]
    assert ended_goals(rig) == [("aborted", (ESTOP,))]
    assert rig.procedures.rank is Priority.CUT
    rig.until_done()
    assert [event.stop for event in rig.book.events] == ["cut"]


@pytest.mark.parametrize("level", ["settle", "cut"])
def test_torque_that_an_estop_cannot_read_back_off_is_reported(rig: ProcedureRig, level: str) -> None:
    rig.hardware.failing["torque False"] = [SILENT] * 1000
    stop(rig, level)
    rig.until_done()
    assert rig.codes() == ["estop", "TORQUE_MISMATCH"]


@pytest.mark.parametrize("level", ["settle", "cut"])
@pytest.mark.parametrize("mode", [Mode.SIM, Mode.MIRROR])
def test_where_nothing_is_written_an_estop_halts_the_simulation(
    rig: ProcedureRig, mode: Mode, level: str
) -> None:
    rig.condition.mode = mode
    moving(rig)
    stop(rig, level)
    assert ended_goals(rig) == [("aborted", (ESTOP,))]
    assert rig.halted == 1
    assert rig.hardware.log == [] and rig.procedures.rank is None
    assert rig.condition.state == "estop"


def test_without_an_open_bus_an_estop_halts_the_simulation(rig: ProcedureRig) -> None:
    rig.hardware.writers.clear()
    stop(rig)
    assert rig.halted == 1 and rig.hardware.log == []


@pytest.mark.parametrize(
    ("first", "second", "log"),
    [
        ("settle", "settle", False),
        ("settle", "cut", True),
        ("cut", "settle", False),
        ("cut", "cut", False),
    ],
)
def test_only_a_cut_overtakes_a_stop(rig: ProcedureRig, first: str, second: str, log: bool) -> None:
    stop(rig, first)
    rig.ticks(1)
    rig.torque.confirm_stop_begun()
    rig.hardware.log.clear()
    stop(rig, second)
    assert (rig.hardware.log == ["clear", *OFF]) == log
    assert rig.torque.stop_begun == (not log), "what is confirmed of the first is not of the second"
    assert rig.torque.stop_level == ("cut" if "cut" in (first, second) else "settle")


@pytest.mark.parametrize("rank", [Priority.ARM, Priority.DISARM, Priority.FAULT, Priority.SHUTDOWN])
def test_an_estop_overtakes_everything_else(rig: ProcedureRig, rank: Priority) -> None:
    def waits() -> Any:
        yield

    rig.torque.confirm_stop_begun()
    rig.own(rank, waits)
    stop(rig)
    assert rig.procedures.rank is Priority.ESTOP
    assert not rig.torque.stop_begun
    [outcome] = rig.outcomes
    assert isinstance(outcome, CallFailure)


def test_each_level_has_its_urgency() -> None:
    assert dict(STOPS) == {"settle": Priority.ESTOP, "cut": Priority.CUT}
