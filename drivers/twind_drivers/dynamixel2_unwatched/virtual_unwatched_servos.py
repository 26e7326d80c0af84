"""Virtual XL-320 and PRO -R on one bus: what their registers do beside those of Protocol 1.0.

An alarm of an XL-320 sets its torque limit to 0, one of a PRO -R clears torque enable (e-manual, "Shutdown").
The error stays until a restart (assumed). Goals are where the shaft is at power-up (assumed). No page states
the position law of a PRO -R: P gain / 128 output counts per count of error, as of the X series.
"""

from collections.abc import Mapping
from math import floor
from typing import Any

import numpy as np

from twind_drivers.dynamixel.packet import StatusErrorCode
from twind_drivers.dynamixel1.virtual_dynamixel1_servos import FULL, VirtualDynamixel1Servos
from twind_drivers.dynamixel2_unwatched.unwatched_identification import kind_of
from twind_drivers.dynamixel2_unwatched.unwatched_models import UnwatchedModel, model
from twind_drivers.dynamixel2_unwatched.unwatched_registers import UnwatchedLayout, layout_of
from twind_drivers.half_duplex.register_table import MappedRegister, RegisterTable
from twind_drivers.virtual.servo_physics import AMPERE

FIRMWARE = 33  # assumed: no page names one
BAUDS = (9600, 57600, 115200, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000, 10_500_000)
DEFAULTS: Mapping[str, Mapping[str, int]] = {
    "xl320": {
        "baud_rate": 3,
        "return_delay_time": 250,
        "control_mode": 2,
        "temperature_limit": 65,
        "min_voltage_limit": 60,
        "max_voltage_limit": 90,
        "max_torque": 1023,
        "status_return_level": 2,
        "shutdown": 3,
    },
    "pro_r": {
        "baud_rate": 1,
        "return_delay_time": 250,
        "operating_mode": 3,
        "moving_threshold": 50,
        "temperature_limit": 80,
        "max_voltage_limit": 400,
        "min_voltage_limit": 150,
        "torque_limit": 620,
        "velocity_limit": 17_000,
        "shutdown": 58,
    },
}


def factory_settings(table: str, lowest: int, highest: int) -> dict[str, int]:
    """Return the EEPROM content of a new servo; `lowest`, `highest`: its position limits."""
    return {**DEFAULTS[table], "min_position_limit": lowest, "max_position_limit": highest}


class VirtualUnwatchedServos(VirtualDynamixel1Servos):
    """m servos of one table. Rows are indices of `specs`; time (s) is an argument and never goes back."""

    UNKNOWN = StatusErrorCode.ACCESS
    OUTSIDE = StatusErrorCode.DATA_RANGE
    BEYOND = StatusErrorCode.DATA_LIMIT
    SIZE = 900
    RAM: Mapping[str, int] = {
        "position_p_gain": 32,
        "punch": 32,
        "velocity_i_gain": 14,
        "velocity_p_gain": 399,
        "status_return_level": 2,
    }

    def _find_model(self, name: str) -> Any:
        found = model(name)
        self._layout: UnwatchedLayout = layout_of(found.table)
        self.table: str = found.table
        torque = self._layout.table["torque_enable"]
        self.KEPT_END = 24 if found.table == "xl320" else torque.address
        bits = {text: bit for bit, text in kind_of(found.table).faults.items()}
        self.VOLTAGE = bits["supply voltage"]
        self.HEAT = bits["overheating"]
        self.OVERLOAD = bits["overload"]
        return found

    def _find_table(self, own: Any) -> RegisterTable:
        return self._layout.table

    def _factory(self, row: int) -> dict[str, int]:
        own = self.models[row]
        firmware = self.specs[row].firmware
        version = FIRMWARE if firmware is None else firmware
        return {**factory_settings(own.table, own.lowest, own.highest), "firmware_version": version}

    def _end(self, row: int) -> int:
        return self._layout.end

    def baud(self, row: int) -> int:
        """Return the rate that the baud register stands for."""
        return BAUDS[min(self.get(row, "baud_rate"), len(BAUDS) - 1)]

    # ------------------------------------------------------------------------------- registers

    def _is_locked(self, row: int, field: MappedRegister, value: int) -> bool:
        """Return True for EEPROM under torque; and for torque while an error is latched, till a restart."""
        torque = field.name == "torque_enable" and value == 1
        shut = torque and self.table == "pro_r" and self._shut(row)
        return shut or (field.kept and self.get(row, "torque_enable") == 1)

    def _shut(self, row: int) -> bool:
        return bool(self.get(row, "hardware_error_status") & self.get(row, "shutdown"))

    def _is_within(self, row: int, goal: int) -> bool:
        ends = (self.get(row, "min_position_limit"), self.get(row, "max_position_limit"))
        return self._is_wheel(row) or ends[0] <= goal <= ends[1]

    def _is_wheel(self, row: int) -> bool:
        return self.get(row, "control_mode") == 1

    def _unload(self, row: int) -> None:
        if self.table == "xl320":
            super()._unload(row)
        else:
            self.put(row, "torque_enable", 0)
        self.put(row, "hardware_error_status", self.error(row))

    def _cap(self, row: int) -> float:
        if self.table == "xl320":
            return super()._cap(row)
        most = self.get(row, "torque_limit")
        goal = abs(self.get(row, "goal_torque")) or most
        return FULL * min(goal, most) / max(most, 1)

    def error(self, row: int) -> int:
        """Return the hardware error bits: those of now, and those that are latched."""
        latched = self.get(row, "hardware_error_status") & self.get(row, "shutdown")
        return super().error(row) | latched

    def _gain(self, row: int) -> float:
        return float(self.get(row, "position_p_gain"))

    # ------------------------------------------------------------------------------- positions

    def _wrap(self, row: int) -> float:
        """Return the turn (counts) that the shaft is in: a PRO -R counts from -half to half of a turn."""
        own: UnwatchedModel = self.models[row]
        return own.turn * floor((float(self.muscles.position[row]) - own.lowest) / own.turn)

    def encoder(self, row: int, count: float) -> float:
        """Return the place of the shaft at which the position register shows `count`."""
        return count - self.get(row, "homing_offset") + self._wrap(row)

    def shown(self, row: int) -> int:
        """Return the count that the position register shows."""
        own: UnwatchedModel = self.models[row]
        count = round(float(self.muscles.position[row]) - self._wrap(row))
        return min(count, own.highest) + self.get(row, "homing_offset")

    def _show_motion(self, row: int, velocity: float) -> None:
        most = FULL if self.table == "xl320" else 2**31 - 1
        self.put(row, "present_velocity", round(np.clip(velocity, -most, most)))
        if self.table == "xl320":
            load = round(float(np.clip(self.muscles.pwm[row], -FULL, FULL)))
            self.put(row, "present_load", load)
        else:
            ampere = float(self.muscles.current[row]) * AMPERE / self.models[row].ampere
            self.put(row, "present_current", round(float(np.clip(ampere, -32767, 32767))))
        self.put(row, "moving", int(abs(velocity) > 5))
        self.put(row, "hardware_error_status", self.error(row))
