"""Preparation for torque over CAN: faults that go late, orders that are lost, actuators left out."""

from typing import Any

import numpy as np
import pytest

from tests.support.can_driver_rig import CanRig
from twind_drivers.bus import DeviceRefused, NoReply, ReadRequest, RequestReply
from twind_drivers.can.odrive_codec import POSITION_GAIN, VELOCITY_GAINS
from twind_drivers.can.register_access import STATE, state
from twind_drivers.ports.frame import Frames

AK = "AK70-10"  # nothing of it is read or written before torque
HERE = np.zeros(2, np.int64)


def report(*ids: int, waited: float = 0.25) -> RequestReply:
    """The state of these ids."""
    return RequestReply({id: state(0, 0) for id in ids}, {}, waited, 0)


# ------------------------------------------------------------------------------------- faults


def test_a_fault_that_is_gone_with_the_third_read_is_no_refusal() -> None:
    rig = CanRig((AK, AK), watchdog=False)
    rig.registers.fault[1] = 3
    script = rig.writer.prepare(HERE)
    next(script)
    reads = [script.send(report(2)) for _ in range(3)]
    assert reads == [ReadRequest((2,), STATE, len(state(0, 0)))] * 3
    rig.registers.fault[1] = 0
    with pytest.raises(StopIteration):
        script.send(report(2))


def test_a_fault_that_stays_is_refused_after_three_reads() -> None:
    rig = CanRig((AK, AK), watchdog=False)
    rig.registers.fault[:] = 1, 3
    script = rig.writer.prepare(HERE)
    next(script)
    assert [script.send(report(1, 2)).ids for _ in range(2)] == [(1, 2)] * 2
    rig.registers.fault[0] = 0
    assert script.send(report(1, 2)).ids == (2,)
    with pytest.raises(DeviceRefused, match=r"id 2: fault: fault bits 0x3 stay though cleared"):
        script.send(report(2))


def test_an_actuator_that_does_not_tell_its_faults_is_reported_once_the_others_are_prepared() -> None:
    rig = CanRig((AK, AK), watchdog=False)
    rig.registers.fault[:] = 1, 3
    script = rig.writer.prepare(HERE)
    next(script)
    for _ in range(3):
        script.send(report(1))
    [order] = script.send(report(1)).writes
    assert list(order.data) == [1]
    rig.registers.fault[0] = 0
    with pytest.raises(NoReply, match="no reply to read of its faults") as missing:
        script.send(report(1))
    assert (missing.value.ids, missing.value.waited) == ((2,), 0.75)


@pytest.mark.parametrize("phase", range(0, 12, 2))
def test_a_fault_of_an_axis_is_cleared_at_its_next_heartbeat(phase: int) -> None:
    """It comes ten times a second, and no read of an ODrive brings its faults."""
    rig = CanRig(("ODrive", "ODrive"))
    here = rig.positions()
    rig.faults.damage(1, 0x40)
    rig.ticks(60 + phase)
    assert (rig.registers.fault > 0).tolist() == [True, False]
    rig.beside(rig.writer.prepare(here))
    assert rig.registers.fault.tolist() == [0, 0]


# ------------------------------------------------------------------------------------- gains


@pytest.mark.parametrize("lost", [POSITION_GAIN, VELOCITY_GAINS])
def test_an_axis_is_as_stiff_as_before_damping_although_an_order_of_gains_is_lost(
    lost: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = CanRig(("ODrive",))
    here = rig.arm()
    held = rig.bus.nodes.each[0].held  # type: ignore[attr-defined]
    stiff = held["position_gain"], held["velocity_gain"]
    rig.beside(rig.writer.damp())
    assert held["position_gain"] == 0.0
    sent: Any = rig.channel.send
    left = [lost]

    def send(frames: Frames, now: float) -> None:
        wanted = np.ones(len(frames), np.bool_)
        for place, id in enumerate(frames["id"].tolist()):
            if id & 0x1F in left:
                left.clear()
                wanted[place] = False
        sent(frames[wanted], now)

    monkeypatch.setattr(rig.channel, "send", send)
    rig.beside(rig.writer.prepare(here))
    assert not left
    assert (held["position_gain"], held["velocity_gain"]) == stiff
