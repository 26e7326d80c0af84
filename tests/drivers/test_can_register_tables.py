"""Registers of CAN actuators as the sources of each family print them: number, type, what may be written."""

from collections.abc import Mapping

import pytest

from twind_drivers.can import damiao_codec, odrive_codec, robstride_codec
from twind_drivers.can.actuator_family import FamilyRegister, RegisterType

U32, F32, U8, I16 = RegisterType.U32, RegisterType.F32, RegisterType.U8, RegisterType.I16
Row = tuple[int, RegisterType, bool, bool]  # number, type, may be written, survives power-off

DAMIAO: Mapping[str, Row] = {
    "under_voltage": (0, F32, True, True),
    "over_temperature": (2, F32, True, True),
    "over_current": (3, F32, True, True),
    "acceleration": (4, F32, True, True),
    "deceleration": (5, F32, True, True),
    "max_speed": (6, F32, True, True),
    "master_id": (7, U32, False, True),
    "esc_id": (8, U32, False, True),
    "timeout": (9, U32, True, True),
    "mode": (10, U32, True, True),
    "hardware_version": (13, U32, False, True),
    "firmware": (14, U32, False, True),
    "serial_number": (15, U32, False, True),
    "position_range": (21, F32, False, True),
    "velocity_range": (22, F32, False, True),
    "torque_range": (23, F32, False, True),
    "current_bandwidth": (24, F32, True, True),
    "speed_kp": (25, F32, True, True),
    "speed_ki": (26, F32, True, True),
    "position_kp": (27, F32, True, True),
    "position_ki": (28, F32, True, True),
    "over_voltage": (29, F32, True, True),
    "can_rate": (35, U32, False, True),
}
ROBSTRIDE: Mapping[str, Row] = {
    "mcu_low": (0, U32, False, True),
    "mcu_high": (4, U32, False, True),
    "run_mode": (0x7005, U8, True, False),
    "iq_reference": (0x7006, F32, False, False),
    "velocity_reference": (0x700A, F32, False, False),
    "torque_limit": (0x700B, F32, True, True),
    "current_kp": (0x7010, F32, True, True),
    "current_ki": (0x7011, F32, True, True),
    "current_filter": (0x7014, F32, True, True),
    "position_reference": (0x7016, F32, False, False),
    "speed_limit": (0x7017, F32, True, True),
    "current_limit": (0x7018, F32, True, True),
    "mechanical_position": (0x7019, F32, False, False),
    "filtered_iq": (0x701A, F32, False, False),
    "mechanical_velocity": (0x701B, F32, False, False),
    "bus_voltage": (0x701C, F32, False, False),
    "turn_count": (0x701D, I16, False, False),
    "velocity_acceleration": (0x7022, F32, True, True),
    "profile_speed": (0x7024, F32, True, True),
    "profile_acceleration": (0x7025, F32, True, True),
    "timeout": (0x7028, U32, True, True),
}
ODRIVE: Mapping[str, Row] = {  # number of the command; + 256: the second half of its answer
    "motor_error": (0x03, U32, False, False),
    "encoder_error": (0x04, U32, False, False),
    "controller_error": (0x1D, U32, False, False),
    "iq_setpoint": (0x14, F32, False, False),
    "iq_measured": (0x114, F32, False, False),
    "bus_voltage": (0x17, F32, False, False),
    "bus_current": (0x117, F32, False, False),
}


@pytest.mark.parametrize(
    ("found", "printed"),
    [
        (damiao_codec.PARAMETERS, DAMIAO),
        (robstride_codec.PARAMETERS, ROBSTRIDE),
        (odrive_codec.PARAMETERS, ODRIVE),
    ],
    ids=["damiao", "robstride", "odrive"],
)
def test_each_register_has_the_number_and_type_of_its_source(
    found: Mapping[str, FamilyRegister], printed: Mapping[str, Row]
) -> None:
    assert {each.name: tuple(each[1:5]) for each in found.values()} == printed


@pytest.mark.parametrize("timeout", [damiao_codec.TIMEOUT, robstride_codec.TIMEOUT])
def test_a_tick_of_a_watchdog_is_a_twentieth_of_a_millisecond(timeout: FamilyRegister) -> None:
    assert timeout.unit == pytest.approx(50e-6)
