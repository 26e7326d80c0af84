"""Columns over all servos of a bus for the registers that rules and packets use."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twind_drivers.dynamixel.packet import LAST_ID, StatusErrorCode
from twind_drivers.virtual.register_memory import RegisterMemory

PROTOCOL = 2  # of register 13
NO_ID = 255
SECONDARY = ("secondary_id", "secondary_shadow_id")  # register 12, by the model's table
COLUMNS: Mapping[str, tuple[int, bool]] = {  # register -> size and sign where a model lacks it
    "model_number": (2, False),
    "firmware_version": (1, False),
    "id": (1, False),
    "baud_rate": (1, False),
    "return_delay_time": (1, False),
    "drive_mode": (1, False),
    "secondary_id": (1, False),
    "secondary_shadow_id": (1, False),
    "protocol_type": (1, False),
    "operating_mode": (1, False),
    "homing_offset": (4, True),
    "pwm_limit": (2, False),
    "current_limit": (2, False),
    "max_position_limit": (4, True),
    "min_position_limit": (4, True),
    "shutdown": (1, False),
    "startup_configuration": (1, False),
    "torque_enable": (1, False),
    "status_return_level": (1, False),
    "registered_instruction": (1, False),
    "hardware_error_status": (1, False),
    "position_d_gain": (2, False),
    "position_i_gain": (2, False),
    "position_p_gain": (2, False),
    "bus_watchdog": (1, False),
    "goal_pwm": (2, True),
    "goal_current": (2, True),
    "profile_acceleration": (4, False),
    "profile_velocity": (4, False),
    "goal_position": (4, True),
    "temperature_limit": (1, False),
    "max_voltage_limit": (2, False),
    "min_voltage_limit": (2, False),
    "velocity_limit": (4, False),
    "velocity_i_gain": (2, False),
    "velocity_p_gain": (2, False),
    "goal_velocity": (4, True),
}


class RegisterColumns:
    """Named columns of one memory, and derived values of single servos."""

    def __init__(self, memory: RegisterMemory) -> None:
        self._memory = memory
        self._columns = {key: memory.column(key, size, signed=sign) for key, (size, sign) in COLUMNS.items()}
        self._has = {
            key: np.array([key in table for table in memory.tables]) for key in (*SECONDARY, "protocol_type")
        }

    def __getitem__(self, key: str) -> NDArray[Any]:
        """Return the values (m,) of one of `COLUMNS`; do not write to them."""
        return self._columns[key].get()

    def put(self, key: str, value: Any, rows: Any = slice(None)) -> None:
        """Write a register past all rules; `changed` must follow."""
        self._columns[key].put(value, rows)

    def ids(self) -> list[int]:
        """Ids, in rows; two may be the same."""
        return [int(each) for each in self["id"]]

    def id_of(self, row: int) -> int:
        """The id that a servo answers with."""
        return int(self["id"][row])

    def shadows(self) -> list[int]:
        """The secondary id that each servo listens to as well; `NO_ID`: none, or its own goes before."""
        found = np.full(len(self._memory.raw), NO_ID)
        for key, has in self._has.items():
            if key in SECONDARY:
                found = np.where(has & (self[key] <= LAST_ID) & (self[key] != self["id"]), self[key], found)
        return [int(each) for each in found]

    def hearing(self) -> list[bool]:
        """Servos (m,) set to Protocol 2.0 (register 13). With another one they ignore this wire."""
        other = self._has["protocol_type"] & (self["protocol_type"] != PROTOCOL)
        return [bool(each) for each in ~other]

    def level(self, row: int) -> int:
        """Status return level (68): 0 answers ping only, 1 reads too, 2 everything."""
        return int(self["status_return_level"][row])

    def delays(self, rows: Sequence[int]) -> list[float]:
        """Return the return delay (register 9, 2 us units) of each row, s."""
        return [int(self["return_delay_time"][row]) * 2e-6 for row in rows]

    def identity(self, row: int) -> bytes:
        """Return the data of a ping: model number, firmware."""
        model = int(self["model_number"][row]).to_bytes(2, "little")
        return model + bytes((int(self["firmware_version"][row]),))

    def read(self, row: int, address: int, size: int) -> tuple[int, bytes]:
        """Return (error, data): the registers of one servo, gaps as 0. Error 7 without any register."""
        if not self._memory.readable(row, address, size):
            return StatusErrorCode.ACCESS, b""
        return StatusErrorCode.NONE, self._memory.read(row, address, size)

    def has_measured_registers(self, rows: Sequence[int], address: int, size: int) -> int:
        """Return True if the span contains registers that the servos write themselves. As `Memory.live`."""
        return max(self._memory.has_measured_registers(row, address, size) for row in rows)

    def answers_fast(self, row: int) -> bool:
        """Return True if its firmware supports the fast reads (e-manual, "Fast Sync Read")."""
        first = self._memory.tables[row].facts.fast_from
        return first is not None and int(self["firmware_version"][row]) >= first

    def selection(self, rows: Sequence[int]) -> Any:
        """An index of these rows: a slice (a view, not a copy) where they are all, in order."""
        every = list(rows) == list(range(len(self._memory.raw)))
        return slice(None) if every else np.asarray(rows, np.intp)

    def goal_span(self) -> bytes:
        """Address and size of the goal position as a sync write spells them; empty where they differ."""
        address = self._columns["goal_position"].address
        return address.to_bytes(2, "little") + b"\x04\x00" if address >= 0 else b""
