"""Register tables of Protocol 1.0: AX, RX and EX; MX; MX with a current sensor. Pure.

Source: e-manual, "Control Table" of AX-12A, RX-28, EX-106+, MX-28 and MX-64. Numbers with a direction have it
in bit 10, set for clockwise, towards lower counts.
"""

from functools import cache

from twind_drivers.dynamixel1.dynamixel1_models import Dynamixel1Model
from twind_drivers.half_duplex.register_table import RegisterTable, parse_registers

EEPROM_END = 24  # the first RAM register
BLOCKS = ((0, EEPROM_END), (EEPROM_END, 26))  # all registers that every model has
CURRENT_MODE = (70, 1)  # address and size: torque control mode of MX-64 and MX-106
GOAL = (30, 2)
TORQUE = 24
START = 36  # present position

# name, address, size, sign bit (- none), least, most; least = most: read only
_IDENTITY = """
model_number 0 2 - 0 0
firmware_version 2 1 - 0 0
id 3 1 - 0 253
"""
_ALL = """
baud_rate 4 1 - 0 254
return_delay_time 5 1 - 0 254
min_position_limit 6 2 - 0 4095
max_position_limit 8 2 - 0 4095
temperature_limit 11 1 - 0 150
min_voltage_limit 12 1 - 50 250
max_voltage_limit 13 1 - 50 250
max_torque 14 2 - 0 1023
status_return_level 16 1 - 0 2
led_alarm 17 1 - 0 127
shutdown 18 1 - 0 127
torque_enable 24 1 - 0 1
led 25 1 - 0 7
goal_position 30 2 - 0 4095
moving_speed 32 2 - 0 1023
torque_limit 34 2 - 0 1023
present_position 36 2 - 0 0
present_velocity 38 2 10 0 0
present_load 40 2 10 0 0
present_input_voltage 42 1 - 0 0
present_temperature 43 1 - 0 0
registered_instruction 44 1 - 0 0
moving 46 1 - 0 0
lock 47 1 - 0 1
punch 48 2 - 0 1023
"""
_AX = """
cw_compliance_margin 26 1 - 0 254
ccw_compliance_margin 27 1 - 0 254
cw_compliance_slope 28 1 - 1 254
ccw_compliance_slope 29 1 - 1 254
"""
_DRIVE_MODE = """
drive_mode 10 1 - 0 3
"""
_MX = """
multi_turn_offset 20 2 - 0 0
resolution_divider 22 1 - 1 4
position_d_gain 26 1 - 0 254
position_i_gain 27 1 - 0 254
position_p_gain 28 1 - 0 254
goal_acceleration 73 1 - 0 254
"""
_CURRENT = """
present_current 68 2 - 0 0
torque_control_mode 70 1 - 0 1
goal_torque 71 2 10 -1023 1023
"""


def baud_of(code: int) -> int:
    """Return the rate that register 4 stands for, as ports name it."""
    fast = {250: 2_250_000, 251: 2_500_000, 252: 3_000_000}
    named = {34: 57_600, 16: 115_200, 103: 19_200, 207: 9_600}
    return fast.get(code) or named.get(code) or 2_000_000 // (code + 1)


@cache
def registers_of(name: str) -> RegisterTable:
    """Return the table `ax`, `ex`, `mx`, `mx_current`, `mx_106` or `unknown`. Raises KeyError."""
    texts = {
        "ax": _IDENTITY + _ALL + _AX,
        "ex": _IDENTITY + _ALL + _AX + _DRIVE_MODE,
        "mx": _IDENTITY + _ALL + _MX,
        "mx_current": _IDENTITY + _ALL + _MX + _CURRENT,
        "mx_106": _IDENTITY + _ALL + _MX + _CURRENT + _DRIVE_MODE,
        "unknown": _IDENTITY,
    }
    return RegisterTable(f"a Dynamixel of Protocol 1.0 ({name})", parse_registers(texts[name], EEPROM_END))


def table_of(model: Dynamixel1Model | None) -> RegisterTable:
    """Return the table of a model; None: what every device has."""
    if model is None:
        return registers_of("unknown")
    return registers_of({"EX-106": "ex", "MX-106(1.0)": "mx_106"}.get(model.name, model.table))
