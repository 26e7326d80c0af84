"""Register tables of XL-320 and PRO -R. Pure.

Source: e-manual, "Control Table" of XL-320 and of H54-200-S500-R, whose table the other PRO -R share. Speed
and load of an XL-320 have their direction in bit 10, set for clockwise, towards lower counts; the numbers of
a PRO -R are two's complement.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from twind_drivers.half_duplex.register_table import RegisterTable, parse_registers

IDENTITY = (0, 7)  # address and size: model number and firmware of every table

# name, address, size, sign bit (- none, 2s two's complement), least, most; least = most: read only
_XL320 = """
model_number 0 2 - 0 0
firmware_version 2 1 - 0 0
id 3 1 - 0 252
baud_rate 4 1 - 0 3
return_delay_time 5 1 - 0 254
min_position_limit 6 2 - 0 1023
max_position_limit 8 2 - 0 1023
control_mode 11 1 - 1 2
temperature_limit 12 1 - 0 150
min_voltage_limit 13 1 - 50 250
max_voltage_limit 14 1 - 50 250
max_torque 15 2 - 0 1023
status_return_level 17 1 - 0 2
shutdown 18 1 - 0 7
torque_enable 24 1 - 0 1
led 25 1 - 0 7
position_d_gain 27 1 - 0 254
position_i_gain 28 1 - 0 254
position_p_gain 29 1 - 0 254
goal_position 30 2 - 0 1023
moving_speed 32 2 - 0 2047
torque_limit 35 2 - 0 1023
present_position 37 2 - 0 0
present_velocity 39 2 10 0 0
present_load 41 2 10 0 0
present_input_voltage 45 1 - 0 0
present_temperature 46 1 - 0 0
registered_instruction 47 1 - 0 0
moving 49 1 - 0 0
hardware_error_status 50 1 - 0 0
punch 51 2 - 0 1023
"""
_PRO_R = """
model_number 0 2 - 0 0
model_information 2 4 - 0 0
firmware_version 6 1 - 0 0
id 7 1 - 0 252
baud_rate 8 1 - 0 13
return_delay_time 9 1 - 0 255
operating_mode 11 1 - 0 4
homing_offset 13 4 2s -2147483648 2147483647
moving_threshold 17 4 - 0 2147483647
temperature_limit 21 1 - 0 100
max_voltage_limit 22 2 - 0 400
min_voltage_limit 24 2 - 0 400
acceleration_limit 26 4 - 0 2147483647
torque_limit 30 2 - 0 1860
velocity_limit 32 4 - 0 2147483647
max_position_limit 36 4 2s -2147483648 2147483647
min_position_limit 40 4 2s -2147483648 2147483647
external_port_mode_1 44 1 - 0 3
external_port_mode_2 45 1 - 0 3
external_port_mode_3 46 1 - 0 3
external_port_mode_4 47 1 - 0 3
shutdown 48 1 - 0 255
torque_enable 562 1 - 0 1
led_red 563 1 - 0 255
led_green 564 1 - 0 255
led_blue 565 1 - 0 255
velocity_i_gain 586 2 - 0 65535
velocity_p_gain 588 2 - 0 65535
position_p_gain 594 2 - 0 32767
goal_position 596 4 2s -2147483648 2147483647
goal_velocity 600 4 2s -2147483648 2147483647
goal_torque 604 2 2s -1860 1860
goal_acceleration 606 4 - 0 2147483647
moving 610 1 - 0 0
present_position 611 4 2s 0 0
present_velocity 615 4 2s 0 0
present_current 621 2 2s 0 0
present_input_voltage 623 2 - 0 0
present_temperature 625 1 - 0 0
registered_instruction 890 1 - 0 0
status_return_level 891 1 - 0 2
hardware_error_status 892 1 - 0 0
"""
Block = tuple[int, int]  # address, size


@dataclass(frozen=True, slots=True)
class UnwatchedLayout:
    """Registers of one kind of servo, and the blocks that are read together."""

    table: RegisterTable
    settings: tuple[Block, ...]  # all registers that identification and arming depend on
    slow: tuple[Block, ...]  # torque, supply, temperature, error
    row: np.dtype[np.void]  # position, velocity and effort as they lie in the cyclic block
    start: int  # address of the cyclic block
    wider: tuple[Block, ...]  # longer blocks: bytes before the cyclic one, bytes of the whole
    limit: str  # RAM register that caps the torque ...
    most: str  # ... and the one that bounds it
    gains: tuple[str, ...]  # P first
    profile: tuple[str, ...]  # set to 0: no limit, the executor shapes the motion
    end: int  # first address behind the table


@cache
def layout_of(table: str) -> UnwatchedLayout:
    """Return the layout `xl320` or `pro_r`. Raises KeyError."""
    return {"xl320": _xl320, "pro_r": _pro_r}[table]()


def _xl320() -> UnwatchedLayout:
    return UnwatchedLayout(
        table=RegisterTable("an XL-320", parse_registers(_XL320, 24)),
        settings=((0, 19), (24, 29)),
        slow=((24, 27),),
        row=np.dtype([("position", "<u2"), ("velocity", "<u2"), ("effort", "<u2")]),
        start=37,
        wider=tuple((0, size) for size in range(7, 17)),
        limit="torque_limit",
        most="max_torque",
        gains=("position_p_gain", "position_i_gain", "position_d_gain"),
        profile=("moving_speed",),
        end=53,
    )


def _pro_r() -> UnwatchedLayout:
    fields: Any = {
        "names": ["position", "velocity", "effort"],
        "formats": ["<i4", "<i4", "<i2"],
        "offsets": [0, 4, 10],
        "itemsize": 12,
    }
    return UnwatchedLayout(
        table=RegisterTable("a PRO -R", parse_registers(_PRO_R, 562)),
        settings=((0, 49), (562, 64), (890, 3)),
        slow=((562, 64), (892, 1)),
        row=np.dtype(fields),
        start=611,
        wider=tuple((0, size) for size in range(13, 23)),
        limit="goal_torque",
        most="torque_limit",
        gains=("position_p_gain",),
        profile=("goal_velocity", "goal_acceleration"),
        end=893,
    )
