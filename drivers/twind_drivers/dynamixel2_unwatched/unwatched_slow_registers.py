"""Slow registers of a bus of XL-320 or PRO -R: torque, hardware error, supply and temperature. Pure.

An alarm of an XL-320 sets the torque limit to 0 (e-manual, "Shutdown (18)"). One with torque limit 0 has no
torque, whatever its switch reads.
"""

from collections.abc import Sequence

import numpy as np

from twind_drivers.bus import Bools, Ints, ReadRequest
from twind_drivers.dynamixel2_unwatched.unwatched_registers import UnwatchedLayout
from twind_drivers.half_duplex.pending_reply import Octets
from twind_drivers.half_duplex.slow_register_slices import SlowRegisterSlices

SHUT_DOWN = 0x80  # ours, no bit of the register: the torque limit reads 0
VOLT = 0.1  # V per raw unit


class UnwatchedSlowRegisters(SlowRegisterSlices):
    """Slow registers of each id, in the blocks `layout.slow`; each is read in slices of its own."""

    def __init__(self, ids: tuple[int, ...], layout: UnwatchedLayout) -> None:
        super().__init__(ids, layout.slow[0])
        self._layout = layout
        self._torque_time, self._fault_time = np.full((2, len(ids)), -np.inf)

    def schedule(self, ids: Sequence[int], slots: int, most: int) -> list[ReadRequest]:
        """Schedule as `SlowRegisterSlices`; further blocks take slots of their own, for as many devices."""
        others = self._layout.slow[1:]
        slices = super().schedule(ids, max(1, slots - len(others)), most)
        parts = [tuple(ids[first : first + most]) for first in range(0, len(ids), most)]
        slices += [ReadRequest(part, *block) for block in others for part in parts]
        self._slots = max(slots, len(slices))
        return slices

    def ask_first(self, id: int) -> None:
        """Schedule all slow registers of a returned device first."""
        self._first += [ReadRequest((id,), *block) for block in self._layout.slow]

    def forget(self, id: int) -> None:
        """Reset the values of a restarted device to unknown."""
        super().forget(id)
        self._torque_time[self._index[id]] = self._fault_time[self._index[id]] = -np.inf

    def _store(self, query: ReadRequest, data: Octets, places: np.ndarray, time: float) -> None:
        state = self.registers
        torque = self._column(query, data, "torque_enable")
        fault = self._column(query, data, "hardware_error_status")
        voltage = self._column(query, data, "present_input_voltage")
        if torque is not None:
            state.torque[places] = torque == 1
            self._torque_time[places] = time
        if fault is not None:
            off = self._is_shut_down(query, data, torque)
            state.fault[places] = fault | np.where(off, SHUT_DOWN, 0)
            state.torque[places] &= ~off
            self._fault_time[places] = time
        if voltage is not None:
            temperature = self._column(query, data, "present_temperature")
            assert temperature is not None  # the register behind it
            state.voltage[places] = voltage * VOLT
            state.temperature[places] = temperature
            state.health_time[places] = time
        state.status_time[places] = np.minimum(self._torque_time[places], self._fault_time[places])

    def _is_shut_down(self, query: ReadRequest, data: Octets, torque: Ints | None) -> Bools:
        """Return the devices whose torque switch is on and whose torque limit is 0."""
        limit = self._column(query, data, "torque_limit")
        if torque is None or limit is None:
            return np.zeros(len(data), np.bool_)
        off: Bools = (torque == 1) & (limit == 0)
        return off

    def _column(self, query: ReadRequest, data: Octets, name: str) -> Ints | None:
        """Return a register of one or two bytes of each row; None: it is not in the block."""
        field = self._layout.table[name]
        at = field.address - query.address
        if not 0 <= at <= query.size - field.size:
            return None
        words = data[:, at : at + field.size].astype(np.int64)
        return words @ (256 ** np.arange(field.size))
