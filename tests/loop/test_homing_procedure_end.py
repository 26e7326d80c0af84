"""A joint driven against its stop, ended in every way there is: torque is off, and everything is undone.

What is undone is read in the servos themselves, past the bus and the daemon's word.
"""

from collections.abc import Callable, Mapping
from typing import Any

import pytest

from tests.support.homing_rig import JOINT, OTHER, RAD, Homed, codes, energise, failed, homed
from twind import link
from twind.loop.procedures.internal_faults import fail, inhibit
from twind.loop.procedures.torque_readback import torque_inherited
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Mode

End = tuple[Callable[[Homed], Any], set[ReasonCode]]
STOPPED = {ReasonCode.ESTOP, ReasonCode.NOT_ARMED}
ENDS: Mapping[str, End] = {
    "its servo falls silent": (lambda made: made.bus.faults.silence(made.spec.id), {ReasonCode.STATE_STALE}),
    "another master speaks": (
        lambda made: [(made.bus.faults.foreign(3), made.ticks(5)) for _ in range(4)],
        {ReasonCode.FOREIGN_TRAFFIC, ReasonCode.BUS_ERRORS},
    ),
    "its cap is not obeyed": (lambda made: made.put("goal_current", 1193), {ReasonCode.OVERCURRENT}),
    "it moves against its way": (lambda made: shove(made, 0.35), {ReasonCode.STOP_NOT_FOUND}),
    "it runs ahead": (lambda made: shove(made, -0.35), {ReasonCode.STOP_NOT_FOUND}),
    "its watchdog trips": (lambda made: trip(made), {ReasonCode.WATCHDOG_TRIPPED}),
    "a hardware error": (lambda made: made.bus.faults.damage(made.spec.id, 32), {ReasonCode.SERVO_ALERT}),
    "it restarts": (
        lambda made: made.bus.faults.brown_out(made.spec.id),
        {
            ReasonCode.STATE_STALE,
            ReasonCode.SERVO_REBOOTED,
            ReasonCode.TORQUE_MISMATCH,
            ReasonCode.STOP_NOT_FOUND,
        },
    ),
    "its torque goes off": (lambda made: made.put("torque_enable", 0), {ReasonCode.TORQUE_MISMATCH}),
    "another joint has torque": (lambda made: energise(made, 5), {ReasonCode.TORQUE_MISMATCH}),
    "its shaft is held fast": (lambda made: made.bus.faults.lock(made.spec.id), {ReasonCode.STOP_NOT_FOUND}),
    "its encoder is frozen": (lambda made: made.bus.faults.freeze(made.spec.id), {ReasonCode.STOP_NOT_FOUND}),
    "the machine slept": (lambda made: made.clock.sleep_until(made.clock.now() + 0.5), {ReasonCode.TIME_GAP}),
    "the lease is given back": (lambda made: made.call(link.ReleaseLease), {ReasonCode.LEASE_LOST}),
    "the lease is taken": (
        lambda made: made.call(link.AcquireLease, client=OTHER, take=True),
        {ReasonCode.LEASE_LOST},
    ),
    "the front is lost": (lambda made: setattr(made.loop.parts.link, "lost", True), {ReasonCode.LEASE_LOST}),
    "no client can connect": (
        lambda made: made.front.outer.send(link.encode(link.Reachable(missing="control.sock: removed"))),
        {ReasonCode.SOCKETS_GONE},
    ),
    "an e-stop": (lambda made: made.call(link.EStop, client=OTHER), STOPPED),
    "an e-stop that cuts": (lambda made: made.call(link.EStop, client=OTHER, level="cut"), STOPPED),
    "somebody cancels": (lambda made: made.call(link.Cancel, client=OTHER), {ReasonCode.STOP_NOT_FOUND}),
    "somebody disarms": (lambda made: made.call(link.Disarm, client=OTHER), STOPPED),
    "a fault inside": (
        lambda made: fail(made.loop, made.loop.parts.guard.bars or fault()),
        {ReasonCode.INTERNAL},
    ),
    "writing is inhibited": (
        lambda made: inhibit(made.loop, fault(), made.clock.now()),
        {ReasonCode.INTERNAL},
    ),
}


def fault() -> Any:
    return Finding(ReasonCode.INTERNAL, message="made up")


def shove(made: Homed, angle: float) -> None:
    """Something moves the shaft by so much (rad)."""
    made.bus.servos.muscles.position[made.row] += angle * RAD


def trip(made: Homed) -> None:
    made.bus.servos.tripped[made.row] = True
    made.put("bus_watchdog", 255)


@pytest.mark.parametrize("name", ENDS)
def test_homing_ends_with_torque_off_and_registers_restored_after_any_interruption(name: str) -> None:
    end, expected = ENDS[name]
    with homed(start={JOINT: -1.2}) as made:
        made.ready()
        ticket = made.find()
        made.powered(ticket)
        end(made)
        if name == "its servo falls silent":
            made.ticks(30)
            made.bus.faults.silence(made.spec.id, False)
        found = failed(made, ticket)
        assert set(found) & expected, found
        assert made.loop.commands.homing.unrestored is None and not made.loop.torque.energising


@pytest.mark.parametrize("truth", [(-2.6, 1.6), (-1.0, 1.6)])
def test_an_endstop_away_from_its_place_is_not_accepted(truth: tuple[float, float]) -> None:
    with homed(truth={"stops_rad": truth}) as made:
        made.ready()
        assert failed(made, made.find(speed=0.5)) == [ReasonCode.STOP_NOT_FOUND]


@pytest.mark.parametrize("inhibited", [False, True])
def test_a_daemon_that_ends_restores_the_servo_first_and_replies(inhibited: bool) -> None:
    with homed() as made:
        made.ready()
        ticket = made.find()
        made.powered(ticket)
        if inhibited:
            inhibit(made.loop, fault(), made.clock.now())
        made.loop.condition.stop_wanted = True
        for _ in range(300):
            made.ticks(1)
            if made.loop.condition.finished:
                break
        assert made.loop.condition.finished
        assert not any(made.torques()) and made.settings() == made.before
        assert made.replies(ticket)[-1].parameters["phase"] == "failed"


def test_an_adapter_that_goes_and_comes_back_finds_it_undone() -> None:
    with homed() as made:
        made.ready()
        ticket = made.find()
        made.powered(ticket)
        made.bus.faults.unplug()
        reply = made.last(ticket)
        assert reply.parameters["phase"] == "failed"
        assert ReasonCode.DEVICE_MISMATCH in codes(reply), "nobody was told that it is not as it was"
        made.bus.faults.replug()
        made.seconds(3.0)
        made.undone()


@pytest.mark.parametrize("ticks", [2, 14, 18, 24, 30, 50])
@pytest.mark.parametrize("how", ["estop", "gone"])
def test_ended_at_any_step_it_is_undone(ticks: int, how: str) -> None:
    with homed() as made:
        made.ready()
        ticket = made.find()
        made.ticks(ticks)
        if how == "estop":
            made.call(link.EStop, client=OTHER)
            failed(made, ticket)
        else:
            made.front.outer.send(link.encode(link.ConnectionClosed(client=7)))
            made.seconds(3.0)
            made.undone()


def test_a_register_that_differs_after_homing_is_reported_with_both_values() -> None:
    with homed() as made:
        made.ready()
        ticket = made.find(times=2, speed=0.5)
        made.powered(ticket)
        made.put("min_position_limit", 100)
        reply = made.last(ticket)
        assert reply.parameters["phase"] == "failed" and reply.parameters.get("ticks") is None
        [finding] = reply.parameters["findings"]
        assert finding["code"] == ReasonCode.DEVICE_MISMATCH
        assert str(made.before["min_position_limit"]) in finding["message"] and "100" in finding["message"]
        assert not any(made.torques()) and made.get("operating_mode") == made.before["operating_mode"]


@pytest.mark.parametrize("ticks", [1, 2, 3])
def test_an_e_stop_during_torque_off_keeps_the_pending_restore(ticks: int) -> None:
    with homed() as made:
        made.ready()
        ticket = made.find()
        made.powered(ticket)
        made.send(link.ReleaseLease)
        made.ticks(ticks)
        made.call(link.EStop, client=OTHER)
        assert failed(made, ticket)[0] in (ReasonCode.LEASE_LOST, ReasonCode.ESTOP)


def test_an_internal_error_during_homing_switches_torque_off(monkeypatch: pytest.MonkeyPatch) -> None:
    with homed() as made:
        made.ready()
        ticket = made.find()
        made.powered(ticket)
        monkeypatch.setattr("twind.motion.endstop_search.EndstopSearch.step", lambda *_: 1 / 0)
        assert failed(made, ticket) == [ReasonCode.INTERNAL]
        assert ReasonCode.INTERNAL in made.loop.condition.latches


def test_a_search_whose_first_step_fails_is_answered_once_and_leaves_nothing_under_way(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with homed() as made:
        made.ready()
        with monkeypatch.context() as patch:
            patch.setattr("twind.loop.procedures.homing_procedure.HomingProcedure._outcome", lambda *_: 1 / 0)
            ticket = made.find()
            made.ticks(5)
        [reply] = made.replies(ticket)
        assert reply.error == "Busy" and reply.parameters["what"].startswith("failed inside")
        assert made.loop.procedures.rank is None
        assert made.loop.commands.homing.busy() == ""


def test_a_daemon_killed_during_homing_leaves_a_stopped_servo_that_the_next_daemon_reports() -> None:
    with homed() as made:
        made.ready()
        made.powered(made.find())
        made.clock.sleep_until(made.clock.now() + 0.3)  # nobody speaks: its watchdog
        made.front.end(0.0)
        made.front = made.new_front()
        made.loop = made.born(Mode.LIVE)
        made.seconds(1.0)
        assert made.get("bus_watchdog") == 255, "nothing would have stopped it"
        assert torque_inherited(made.loop)
        troubles = [finding.message for finding in made.loop.identity.troubles]
        assert any("operating" in message and "5" in message for message in troubles), troubles
        assert made.call(link.Disarm).error is None
        assert not any(made.torques())
        made.lease()
        made.call(link.Calibrate, on=True)
        how = {"bus": made.spec.bus, "id": made.spec.id, "name": "operating_mode", "value": 3}
        assert made.call(link.WriteRegister, **how).error is None
        made.call(link.Calibrate, on=False)
        made.connect()
        made.lease()
        assert made.call(link.Arm).error is None


def until(made: Homed, done: Callable[[], bool]) -> None:
    for _ in range(300):
        if done():
            return
        made.ticks(1)
    raise AssertionError("never")


def test_a_jump_when_torque_comes_on_ends_it() -> None:
    with homed() as made:
        made.ready()
        ticket = made.find()
        until(made, lambda: bool(made.get("torque_enable")))
        shove(made, 0.3)
        made.bus.faults.lock(made.spec.id)
        assert failed(made, ticket) == [ReasonCode.STOP_NOT_FOUND]


@pytest.mark.parametrize("moves", [-0.003, 0.003])  # rad a tick: on its way, and out of its window
def test_a_joint_that_begins_to_move_before_torque_gets_none(moves: float) -> None:
    with homed(start={JOINT: -0.6}) as made:
        made.ready()
        ticket = made.find()
        until(made, lambda: made.get("operating_mode") == 5)
        while not [reply for reply in made.replies(ticket) if not reply.continues]:
            shove(made, moves)
            made.ticks(1)
            assert not made.get("torque_enable")
        assert failed(made, ticket) == [ReasonCode.STOP_NOT_FOUND]


def test_a_count_that_is_no_whole_turn_off_in_the_other_mode_ends_it() -> None:
    with homed() as made:
        made.ready()
        made.put("homing_offset", 2000)  # inert in mode 3, live in mode 5 (e-manual, "Homing Offset (20)")
        made.before["homing_offset"] = 2000
        assert failed(made, made.find()) == [ReasonCode.CALIB_MISMATCH]


def test_a_bus_that_is_asked_anew_who_is_there_ends_it() -> None:
    with homed() as made:
        made.ready()
        ticket = made.find()
        made.powered(ticket)
        made.loop.hardware.ports[0].identify()
        assert failed(made, ticket) == [ReasonCode.HW_DISCONNECTED]


def test_an_unconfirmed_torque_off_is_reported_and_restored_when_the_servo_replies() -> None:
    with homed() as made:
        made.ready()
        ticket = made.find()
        made.powered(ticket)
        made.bus.faults.silence(made.spec.id)
        made.seconds(3.0)
        made.bus.faults.silence(made.spec.id, False)
        assert {ReasonCode.STATE_STALE, ReasonCode.TORQUE_MISMATCH} <= set(failed(made, ticket))


def test_a_servo_that_has_no_such_mode_is_left_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    with homed() as made:
        made.ready()
        monkeypatch.setattr(
            "twind_drivers.dynamixel.single_servo.mode_of",
            lambda *_: (_ for _ in ()).throw(ValueError("no mode 5")),
        )
        assert failed(made, made.find()) == [ReasonCode.STOP_NOT_FOUND]
