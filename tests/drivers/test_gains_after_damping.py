"""Gains that the robot file leaves to the servo: kept over damping, never taken from an earlier arming."""

from collections.abc import Callable
from typing import Any

import pytest

from tests.support.dynamixel1_rig import QUICK, Dynamixel1Rig
from tests.support.feetech_rig import FeetechRig
from tests.support.unwatched_rig import UnwatchedRig
from twind_drivers.dynamixel1.virtual_dynamixel1_spec import Dynamixel1ServoSpec
from twind_drivers.feetech.virtual_feetech_spec import FeetechServoSpec


def feetech() -> FeetechRig:
    return FeetechRig([FeetechServoSpec(id) for id in (1, 2)])


def mx() -> Dynamixel1Rig:
    return Dynamixel1Rig([Dynamixel1ServoSpec(id, "MX-28(1.0)", QUICK) for id in (1, 2)])


def xl() -> UnwatchedRig:
    return UnwatchedRig(["XL-320"] * 2, {})


GAIN = "position_p_gain"
MAKERS = pytest.mark.parametrize("make", [feetech, mx, xl])


def gains(rig: Any) -> list[int]:
    return [rig.servos.get(row, GAIN) for row in range(2)]


@MAKERS
def test_a_damped_servo_has_its_gains_again_once_its_torque_is_off(make: Callable[[], Any]) -> None:
    """Else the writer of the next mode, port or reload takes the soft gains for the servo's own."""
    rig = make()
    rig.arm()
    own = gains(rig)
    assert rig.beside(rig.writer.damp()) == ()
    assert gains(rig) != own
    rig.beside(rig.writer.torque(False))
    assert gains(rig) == own


@MAKERS
def test_torque_is_off_also_where_a_damped_servo_does_not_take_its_gains_back(
    make: Callable[[], Any],
) -> None:
    rig = make()
    rig.arm()
    own = gains(rig)
    rig.beside(rig.writer.damp())
    write = rig.servos.write
    rig.servos.write = lambda row, address, data: (
        write(row, address, data) if address == rig.writer.TORQUE else 0
    )
    rig.beside(rig.writer.torque(False))
    assert not rig.energised().any()
    rig.servos.write = write
    rig.arm()
    assert gains(rig) == own


@MAKERS
def test_a_gain_that_was_written_after_an_arming_counts_in_the_next(make: Callable[[], Any]) -> None:
    rig = make()
    rig.arm()
    rig.beside(rig.writer.torque(False))
    rig.beside(rig.writer.write(2, GAIN, 17))
    rig.arm()
    assert gains(rig)[1] == 17
