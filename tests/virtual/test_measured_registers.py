"""Present registers of virtual servos whose body runs away: they stop at what they can hold."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind_drivers.dynamixel1.virtual_dynamixel1_servos import VirtualDynamixel1Servos
from twind_drivers.dynamixel1.virtual_dynamixel1_spec import Dynamixel1ServoSpec
from twind_drivers.feetech.virtual_feetech_servos import VirtualFeetechServos
from twind_drivers.feetech.virtual_feetech_spec import FeetechServoSpec
from twind_drivers.half_duplex.register_table import TWOS, MappedRegister
from twind_drivers.virtual.servo_physics import FirstOrderPhysics
from twind_drivers.virtual.virtual_table_servos import VirtualTableServos


def feetech(model: str) -> VirtualTableServos:
    turns = {"phase": 12 | 16} if model == "STS3215" else {}
    return VirtualFeetechServos([FeetechServoSpec(1, model, turns)], FirstOrderPhysics(np.zeros(1)))


def dynamixel1(model: str) -> VirtualTableServos:
    return VirtualDynamixel1Servos([Dynamixel1ServoSpec(1, model)], FirstOrderPhysics(np.zeros(1)), now=0.0)


@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize(
    ("servos", "most"),
    [(feetech("STS3215"), 32767), (feetech("HLS3955"), 32767), (dynamixel1("AX-12A"), 1023)],
)
def test_a_joint_that_runs_away_does_not_end_the_virtual_servos(
    servos: VirtualTableServos, most: int, way: float
) -> None:
    servos.muscles.position[:] = way * 295_409.0
    servos.muscles.velocity[:] = way * 1e9
    servos.muscles.current[:] = way * 1e9
    servos.volts[0] = servos.celsius[0] = 400.0
    servos.refresh()
    assert servos.get(0, "present_velocity") == way * most
    assert (servos.get(0, "present_input_voltage"), servos.get(0, "present_temperature")) == (255, 255)


@pytest.mark.parametrize("way", [1, -1])
def test_a_position_of_many_turns_stops_at_the_end_of_its_register(way: int) -> None:
    servos = feetech("STS3215")
    servos.muscles.position[:] = way * 295_409.0
    servos.refresh()
    assert servos.get(0, "present_position") == way * 32_767


@given(
    st.integers(-(10**12), 10**12),
    st.integers(1, 4),
    st.sampled_from([None, TWOS, 5, 7]),
)
def test_a_clipped_value_is_the_nearest_that_a_register_keeps(
    value: int, size: int, sign: int | None
) -> None:
    register = MappedRegister("x", 0, size, sign, 0, 0, kept=False)
    held = register.clip(value)
    assert register.decode(register.encode(held)) == held
    beyond = held + (1 if value > held else -1)
    if value != held:
        with pytest.raises(OverflowError):
            register.encode(beyond)
