"""Torque over CAN, on and off: nobody runs after a place that changed, nobody who held is let go, no late
answer counts."""

from collections.abc import Sequence
from contextlib import suppress

import numpy as np
import pytest

from tests.support.can_driver_rig import CanRig
from twind_drivers.bus import DeviceRefused, NoReply


@pytest.mark.parametrize("models", [("DM4310",) * 4, ("RS01",) * 3])
def test_armed_actuators_keep_torque_when_another_does_not_reply(models: Sequence[str]) -> None:
    rig = CanRig(models)
    here = rig.arm()
    rig.ticks(5, here)
    rig.open()  # another daemon finds them holding
    rig.positions()
    rig.beside(rig.writer.prepare(here))
    rig.beside(rig.writer.write_goals(here))
    rig.faults.silence(2)
    with pytest.raises(NoReply):
        rig.beside(rig.writer.torque(True))
    assert rig.energised().all()
    rig.ticks(5)
    assert rig.energised()[[0, 2]].all()


@pytest.mark.parametrize("models", [("AK70-10", "DM4310"), ("DM4310", "DM4310"), ("DM4310", "ODrive")])
def test_an_actuator_that_holds_keeps_its_stiffness_while_another_is_enabled(models: Sequence[str]) -> None:
    """It may carry a load, which would sink. That too where the other does not reply."""
    rig = CanRig(models)
    here = rig.arm()
    rig.ticks(100, here)
    rig.beside(rig.writer.reboot(2, shut_down=True)) if models[1] == "ODrive" else rig.faults.silence(2)
    rig.ticks(20, here)
    rig.faults.silence(2, False)
    rig.ticks(20, here)
    assert rig.energised().tolist() == [True, False]
    rig.beside(rig.writer.prepare(here))
    rig.beside(rig.writer.write_goals(here))
    rig.channel.trains.clear()
    rig.faults.silence(2)
    with pytest.raises(NoReply, match=r"\[2\]"):
        rig.beside(rig.writer.torque(True))
    rig.ticks(20)
    commands = [
        frame["data"]
        for train in rig.channel.trains
        for frame in train
        if frame["id"] == 1 and frame["data"].tobytes()[:7] != b"\xff" * 7
    ]
    assert len(commands) > 4
    assert all(data[3] & 15 or data[4] for data in commands), "a command without stiffness"


def test_limp_actuators_are_disabled_again_when_another_does_not_reply() -> None:
    rig = CanRig(("DM4310",) * 3)
    here = rig.positions()
    rig.beside(rig.writer.prepare(here))
    rig.beside(rig.writer.write_goals(here))
    rig.faults.silence(2)
    with pytest.raises(NoReply):
        rig.beside(rig.writer.torque(True))
    rig.ticks(3)
    assert not rig.energised()[[0, 2]].any()


@pytest.mark.parametrize("turns", [1.0, 0.15, -0.02])
def test_a_position_jump_at_torque_on_disables_every_actuator(
    turns: float,
) -> None:
    """An encoder before a gear of 6 or 9 changes by a sixth or a ninth of a turn of the output."""
    rig = CanRig(("DM4310",) * 3)
    here = rig.positions()
    rig.beside(rig.writer.prepare(here))
    rig.beside(rig.writer.write_goals(here))
    rig.faults.wrap(2, turns)
    before = rig.places()
    with pytest.raises(DeviceRefused, match="turn changed"):
        rig.beside(rig.writer.torque(True))
    rig.ticks(5)
    assert not rig.energised().any()
    assert abs(rig.places() - before).max() <= 8


def test_a_single_late_reply_does_not_acknowledge_torque_off() -> None:
    """A CubeMars does not say whether its torque is on: only both answers to both orders count."""
    rig = CanRig(("AK70-10",) * 2)
    rig.ticks(3, rig.arm())
    script = rig.writer.torque(False)
    rig.read()
    order = next(script)
    rig.faults.drop(1, 2)  # of two answers of node 2 one is missing
    reply = rig.transact(order)
    assert int(rig.reader.line.heard.count[1]) == 1
    again = script.send(reply)
    assert rig.registers.torque.tolist() == [0, -1]
    with suppress(StopIteration):
        script.send(rig.transact(again))
    assert np.array_equal(rig.registers.torque, [0, 0])


def test_a_cubemars_left_holding_is_braked_when_it_is_knocked_at_and_never_pulled() -> None:
    """It answers commands alone, so whoever wants to hear it takes its stiffness: damping stays."""
    rig = CanRig(("AK70-10",) * 2)
    rig.ticks(5, rig.arm())
    rig.open()  # another daemon
    rig.ticks(150)
    knocks = [train for train in rig.channel.trains if len(train)]
    assert knocks
    for train in knocks:
        data = train["data"].astype(int)
        kp = (data[:, 3] & 15) << 8 | data[:, 4]
        kd = data[:, 5] << 4 | data[:, 6] >> 4
        assert not kp.any()
        assert (kd > 0).all()
        assert (data[:, 2] << 4 | data[:, 3] >> 4 == 0x7FF).all(), "a speed"
        assert ((data[:, 6] & 15) << 8 | data[:, 7] == 0x7FF).all(), "a torque"


def test_a_loop_too_slow_for_the_watchdogs_is_refused_before_torque() -> None:
    slow = CanRig(("DM4310",) * 2, rate_hz=10.0)
    here = slow.positions()
    with pytest.raises(DeviceRefused, match=r"at 10 Hz a command comes every 0\.100 s: 20 Hz are needed"):
        slow.beside(slow.writer.prepare(here))
    enough = CanRig(("DM4310",) * 2, rate_hz=20.0)
    enough.ticks(20, enough.arm())
    assert enough.energised().all()
    assert (enough.registers.watchdog == 100).all()


@pytest.mark.parametrize("models", [("DM4310",) * 3, ("RS01",) * 3])
def test_an_actuator_without_a_reply_during_preparation_follows_no_goal(
    models: Sequence[str],
) -> None:
    """He is soft, or was away: stiffness towards a place that nobody knows would be a jerk."""
    rig = CanRig(models)
    here = rig.arm()
    rig.ticks(5, here)
    rig.beside(rig.writer.damp())
    rig.faults.silence(2)
    with pytest.raises(NoReply, match=r"\[2\]"):
        rig.beside(rig.writer.prepare(here))
    rig.faults.silence(2, False)
    before = rig.places()
    for step in range(30):
        rig.tick(here + 10 * step)
    moved = rig.places() - before
    assert (moved[[0, 2]] > 100).all()
    assert abs(moved[1]) < 20  # it coasts, damped
    rig.beside(rig.writer.prepare(here))
    rig.beside(rig.writer.torque(True))
    rig.ticks(30, here + 100)
    assert abs(rig.places() - here - 100).max() < 80


def test_a_cubemars_gets_no_command_once_its_writer_is_gone() -> None:
    """Mode mirror only reads: another program may hold the actuator, whose load a soft command would drop."""
    rig = CanRig(("AK70-10",) * 2)
    rig.ticks(5, rig.arm())
    rig.beside(rig.writer.torque(False))
    rig.ticks(5)
    del rig.writer
    rig.channel.trains.clear()
    rig.ticks(150)
    assert not sum(map(len, rig.channel.trains))
