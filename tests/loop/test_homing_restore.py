"""Nothing else is written while a joint is driven against its stop, nobody goes on before it is given back.

What is undone is read in the servos themselves, past the bus and the daemon's word.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.support.homing_rig import JOINT, OTHER, Homed, codes, failed, homed
from twind import link
from twind.loop.bus.joint_readings import JointReadings
from twind.robot.finding import Finding, ReasonCode
from twind_drivers.bus import BusSample, WireRangeError


def until(made: Homed, done: Callable[[], bool], ticks: int = 400) -> None:
    for _ in range(ticks):
        if done():
            return
        made.ticks(1)
    raise AssertionError("never")


def pending_restore(made: Homed) -> int:
    """A search was ended; its servo is silent, so that it cannot be given back. Its ticket."""
    ticket = made.find()
    made.powered(ticket)
    made.send(link.ReleaseLease)
    until(made, lambda: not made.get("torque_enable"))
    made.bus.faults.silence(made.spec.id)
    made.ticks(3)
    assert made.get("operating_mode") == 5 and made.loop.commands.homing.unrestored is not None
    return ticket


# ------------------------------------------------------------------------------- nothing beside it


@pytest.mark.parametrize("reads", [1, 4, 8])
@pytest.mark.parametrize(
    ("kind", "how"),
    [
        (link.WriteRegister, {"name": "operating_mode", "value": 3}),
        (link.WriteRegister, {"name": "bus_watchdog", "value": 0}),
        pytest.param(link.Reboot, {}, marks=pytest.mark.slow),
    ],
)
def test_a_search_is_busy_until_earlier_writes_on_its_bus_are_done(kind: Any, how: Any, reads: int) -> None:
    with homed() as made:
        made.ready()
        device = {"bus": made.spec.bus, "id": made.spec.id}
        for _ in range(reads):
            made.send(link.ReadRegister, **device, name="present_temperature")
        made.send(kind, **device, **how)
        reply = made.last(made.find())
        assert reply.error == "Busy" and made.spec.bus in reply.parameters["what"]
        assert not made.get("torque_enable")


def test_waiting_bus_scripts_are_dropped_before_the_first_write_of_a_search() -> None:
    with homed() as made:
        made.ready()
        ticket = made.find()
        made.ticks(2)
        port = made.loop.hardware.ports[0]
        assert port.reader is not None and port.writer is not None
        waits = [port.run(port.reader.identify()) for _ in range(6)]
        waits.append(port.run(port.writer.write(made.spec.id, "led", 0)))
        until(made, lambda: made.get("operating_mode") == 5)
        assert all(task.done for task in waits) and made.get("led") == 1
        made.call(link.EStop, client=OTHER)
        failed(made, ticket)


def test_a_watchdog_that_is_another_than_was_set_ends_it() -> None:
    with homed() as made:
        made.ready()
        ticket = made.find()
        made.powered(ticket)
        made.put("bus_watchdog", 0)
        assert failed(made, ticket) == [ReasonCode.DEVICE_MISMATCH]


@pytest.mark.parametrize("moves", [0.0, 0.02])
def test_without_readings_nothing_gets_torque(moves: float, monkeypatch: pytest.MonkeyPatch) -> None:
    with homed() as made:
        made.ready()
        deaf = [False]
        take = JointReadings.take

        def lost(self: JointReadings, number: int, sample: BusSample) -> Any:
            heard = sample.heard & ~(deaf[0] & (np.arange(len(sample.heard)) == made.row))
            return take(self, number, replace(sample, heard=heard))

        monkeypatch.setattr(JointReadings, "take", lost)
        ticket = made.find()
        until(made, lambda: made.get("operating_mode") == 5)
        deaf[0] = True
        for _ in range(60):
            made.bus.servos.muscles.position[made.row] += moves * 100
            made.ticks(1)
            assert not made.get("torque_enable")
        deaf[0] = False
        assert failed(made, ticket) == [ReasonCode.STATE_STALE]


def test_bytes_that_may_not_leave_latch(monkeypatch: pytest.MonkeyPatch) -> None:
    def wild(*_: Any) -> None:
        raise WireRangeError("main", 1, 9999, 0, 4095)

    with homed() as made:
        made.ready()
        ticket = made.find()
        made.powered(ticket)
        monkeypatch.setattr("twind_drivers.dynamixel.single_servo.SingleServoControl.goal", wild)
        assert failed(made, ticket) == [ReasonCode.WIRE_CLAMP]
        assert ReasonCode.WIRE_CLAMP in made.loop.condition.latches


# ------------------------------------------------------------------------------- while it is owed


def test_a_joint_that_is_not_given_back_is_in_everybodys_way() -> None:
    with homed() as made:
        made.ready()
        ticket = pending_restore(made)
        troubles = [each for each in made.loop.identity.troubles if each.joint == made.place]
        assert [each.code for each in troubles] == [ReasonCode.CALIB_MISMATCH]
        assert "Operating Mode (11) 5 (was 3)" in troubles[0].message
        assert not made.loop.identity.verified.joints[made.place]
        until(made, lambda: made.loop.procedures.rank is None)
        device = {"bus": made.spec.bus, "id": made.spec.id}
        made.lease()
        made.call(link.Calibrate, on=False)
        for kind, how in (
            (link.SetMode, {"mode": "mirror"}),
            (link.SetMode, {"mode": "sim"}),
            (link.WriteRegister, {**device, "name": "led", "value": 1}),
            (link.Reboot, device),
        ):
            reply = made.call(kind, **how)
            assert reply.error == "Busy" and JOINT in reply.parameters["what"], (kind, reply)
        assert made.call(link.SetMode, mode="live").error is None
        refused = made.call(link.Arm)
        assert ReasonCode.CALIB_MISMATCH in codes(refused)
        assert made.last(ticket).parameters["phase"] == "failed"
        made.bus.faults.silence(made.spec.id, False)
        made.seconds(2.0)
        made.undone()
        assert "its mode and settings are as they were" in made.events("HOMING")[-1].message
        assert made.call(link.SetMode, mode="mirror").error is None


@pytest.mark.parametrize("ticks", [0, pytest.param(12, marks=pytest.mark.slow), 29])
def test_an_early_arm_does_not_interrupt_the_pending_restore(ticks: int) -> None:
    with homed() as made:
        made.ready(odd=False)
        made.put("feedforward_1st_gain", 11)
        made.before = made.settings()
        made.powered(made.find())
        made.call(link.Disarm, client=OTHER)
        made.send(link.Calibrate, on=False)
        made.ticks(ticks)
        assert made.loop.commands.homing.unrestored is not None
        assert ReasonCode.CALIB_MISMATCH in codes(made.call(link.Arm))
        made.undone()


def test_a_daemon_that_ends_meanwhile_names_the_mode_that_is_left() -> None:
    with homed() as made:
        made.ready()
        ticket = made.find()
        made.powered(ticket)
        made.bus.faults.silence(made.spec.id)
        made.ticks(3)
        made.loop.condition.stop_wanted = True
        until(made, lambda: made.loop.condition.finished, 800)
        assert made.get("operating_mode") == 5
        reply = made.replies(ticket)[-1]
        assert codes(reply)[-1] == ReasonCode.DEVICE_MISMATCH
        [told] = made.events(ReasonCode.DEVICE_MISMATCH)
        for message in (told.message, reply.parameters["findings"][-1]["message"]):
            assert "Operating Mode (11) 5 (was 3)" in message


@pytest.mark.parametrize("other", [{"model_number": 1030}, {"firmware": 44}, {"unique_id": "b"}])
def test_another_device_in_its_place_is_given_nothing(other: dict[str, Any]) -> None:
    with homed() as made:
        made.ready()
        ticket = made.find()
        made.powered(ticket)
        debt = made.loop.commands.homing.unrestored
        assert debt is not None
        made.bus.faults.unplug()
        made.ticks(5)
        debt.device = replace(debt.device, **other)  # it was another than who comes back
        made.bus.faults.replug()
        reply = made.last(ticket)
        assert codes(reply)[-1] == ReasonCode.DEVICE_MISMATCH
        assert "another device has its id now" in reply.parameters["findings"][-1]["message"]
        assert made.get("operating_mode") == 5, "it was written to"
        assert made.loop.commands.homing.unrestored is None


def test_an_impossible_restore_does_not_stay_pending(monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*_: Any, **__: Any) -> None:
        raise ValueError("no such mode")

    with homed() as made:
        made.ready()
        ticket = made.find()
        made.powered(ticket)
        monkeypatch.setattr(
            "twind_drivers.dynamixel.dynamixel_writer.DynamixelWriter.begin_single_device", never
        )
        made.send(link.ReleaseLease)
        reply = made.last(ticket)
        assert codes(reply) == [ReasonCode.LEASE_LOST, ReasonCode.DEVICE_MISMATCH]
        assert "no such mode" in reply.parameters["findings"][-1]["message"]
        assert made.loop.commands.homing.unrestored is None


def test_changes_of_the_robot_wait_for_it() -> None:
    with homed() as made:
        made.ready()
        ticket = pending_restore(made)
        until(made, lambda: not made.loop.torque.energising)
        found: tuple[Finding, ...] = made.loop.commands.reloads.at_rest()
        assert [each.code for each in found] == [ReasonCode.BUSY] and JOINT in found[0].message
        made.bus.faults.silence(made.spec.id, False)
        failed(made, ticket)
