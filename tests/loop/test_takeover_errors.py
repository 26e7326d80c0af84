"""Devices and buses that fail while torque that was found on is taken over, on scripted buses."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.support.procedure_rig import BROKEN, SILENT, ProcedureRig
from twind.loop.procedures.torque_takeover import take_over
from twind_drivers.bus import BusError, DeviceRefused, PortError, PortErrorCause

NONE = np.zeros(3, np.bool_)
UPPER = np.array([False, False, True])
REFUSED = DeviceRefused("lower", 2, "bus watchdog (98)", "wrote 05, reads ff")
LOST = PortError("upper", "the adapter was unplugged", PortErrorCause.LOST)


@pytest.fixture
def rig() -> ProcedureRig:
    return ProcedureRig()


def taken(rig: ProcedureRig, whole: bool = False) -> bool:
    return bool(rig.run(take_over(rig, lambda: NONE, whole)))


def test_a_device_that_missed_a_write_is_prepared_once_more_with_all_others(rig: ProcedureRig) -> None:
    """A single lost packet must not drop the robot."""
    rig.found()
    rig.hardware.failing["prepare"] = [REFUSED, None]
    assert taken(rig)
    assert rig.requests() == ["prepare", "prepare", "hold True"]
    assert rig.hardware.among.tolist() == [True, True, True]
    assert rig.torque.held.all()
    assert rig.book.events == []


def test_a_device_that_refuses_twice_does_not_keep_the_others_from_being_lowered(rig: ProcedureRig) -> None:
    other = DeviceRefused("upper", 7, "goal", "data limit")
    rig.found()
    rig.hardware.failing["prepare"] = [REFUSED, other, REFUSED, None]
    assert taken(rig)
    assert rig.requests().count("prepare") == 4
    assert rig.hardware.among.tolist() == [True, False, True]
    assert rig.torque.held.tolist() == [True, False, True]
    [event] = rig.book.events
    assert (event.level, event.code) == ("error", "BUS_ERRORS")
    assert event.message == f"lowered although a device refused: {REFUSED}"


def test_a_device_that_refuses_twice_is_left_out_with_those_of_its_transmission(rig: ProcedureRig) -> None:
    """Its mate alone would turn their joints elsewhere than to the rest pose."""
    rig.robot.joints.transmission_groups = (np.array([1, 2]),)
    rig.found()
    rig.hardware.failing["prepare"] = [REFUSED, REFUSED, None]
    assert taken(rig)
    assert rig.torque.held.tolist() == [True, False, False]


def test_a_limp_device_is_not_prepared_again(rig: ProcedureRig) -> None:
    """Its refusal is none of a joint that would be lowered."""
    rig.found((1, 0, 1))
    rig.hardware.failing["prepare"] = [REFUSED, None]
    with pytest.raises(DeviceRefused):
        taken(rig)


def test_the_take_over_ends_where_the_last_device_refuses_or_an_unknown_one(rig: ProcedureRig) -> None:
    rig.found((0, 1, 0))
    rig.hardware.failing["prepare"] = REFUSED
    with pytest.raises(DeviceRefused):
        taken(rig)
    assert rig.requests() == ["prepare", "prepare"]
    for stranger in (DeviceRefused("lower", 7, "goal", "why"), DeviceRefused("other", 2, "goal", "why")):
        rig.hardware.log.clear()
        rig.hardware.failing["prepare"] = stranger
        with pytest.raises(DeviceRefused):
            taken(rig)
        assert rig.requests() == ["prepare"]


def test_where_the_whole_robot_is_wanted_a_refusal_or_a_lost_bus_fails_it(rig: ProcedureRig) -> None:
    rig.found()
    for error in (REFUSED, LOST):
        rig.hardware.log.clear()
        rig.hardware.failing["prepare"] = error
        with pytest.raises(BusError):
            taken(rig, whole=True)
        assert rig.requests() == ["prepare"]
    assert rig.book.events == []


def test_a_bus_lost_at_the_take_over_does_not_keep_the_others_from_being_lowered(rig: ProcedureRig) -> None:
    rig.found()
    rig.hardware.failing["prepare"] = LOST
    rig.hardware.away = UPPER
    assert taken(rig)
    assert rig.torque.held.tolist() == [True, True, False]
    [event] = rig.book.events
    assert (event.code, event.message) == (
        "DEVICE_MISSING",
        "lowered although a device did not answer: upper: the adapter was unplugged",
    )


@pytest.mark.parametrize("silence", [SILENT, LOST])
def test_a_silent_device_hides_no_refusal_on_another_bus(rig: ProcedureRig, silence: BusError) -> None:
    """That bus is not prepared: its devices would get goals that they ignore."""
    rig.found()
    prepare = rig.hardware.prepare
    errors = [[silence, REFUSED], [silence, None]]

    def prepare_each(*given: Any) -> Any:
        return [replace(prepare(*given)[0], error=error, done=True) for error in errors.pop(0)]

    rig.hardware.prepare = prepare_each
    assert taken(rig)
    assert errors == []
    [event] = rig.book.events
    assert event.message.startswith(f"lowered although a device did not answer: {silence}")


def test_a_silent_device_hides_no_defect_on_another_bus(rig: ProcedureRig) -> None:
    rig.found()
    prepare = rig.hardware.prepare
    rig.hardware.prepare = lambda *given: [
        replace(prepare(*given)[0], error=error, done=True) for error in (SILENT, BROKEN)
    ]
    with pytest.raises(BusError, match="broken"):
        taken(rig)
    assert not rig.torque.armed
