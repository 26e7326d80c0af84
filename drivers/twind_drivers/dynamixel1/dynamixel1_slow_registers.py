"""Slow registers of a bus of Protocol 1.0: torque, supply, temperature and the error byte of the reply. Pure.

No register holds the errors. An alarm sets the torque limit to 0 and leaves the torque switch on, so a servo
with torque limit 0 has no torque, whatever the switch reads.
"""

from collections.abc import Mapping

import numpy as np

from twind_drivers.bus import ReadRequest
from twind_drivers.dynamixel1.dynamixel1_packet import FAULT_BITS, SHUT_DOWN
from twind_drivers.half_duplex.pending_reply import Octets
from twind_drivers.half_duplex.slow_register_slices import SlowRegisterSlices

BLOCK = (24, 20)  # address, size: torque switch .. temperature
LIMIT = 34 - 24
VOLTAGE = 42 - 24
TEMPERATURE = 43 - 24
VOLT = 0.1  # V per raw unit


class Dynamixel1SlowRegisters(SlowRegisterSlices):
    """Slow registers of each id. `errors`: error byte of each reply that is about to be stored, by id."""

    def __init__(self, ids: tuple[int, ...]) -> None:
        super().__init__(ids, BLOCK)
        self.errors: Mapping[int, int] = {}
        self._ids = ids

    def _store(self, query: ReadRequest, data: Octets, places: np.ndarray, time: float) -> None:
        state = self.registers
        torque = BLOCK[0] - query.address
        if not 0 <= torque < query.size:
            return
        on = data[:, torque] == 1
        state.torque[places] = on
        if torque + TEMPERATURE >= query.size:
            return
        off = on & ~data[:, torque + LIMIT : torque + LIMIT + 2].any(1)
        state.torque[places] = on & ~off
        errors = [self.errors.get(self._ids[place], 0) & FAULT_BITS for place in places.tolist()]
        state.fault[places] = np.array(errors, np.int16) | np.where(off, SHUT_DOWN, 0).astype(np.int16)
        state.voltage[places] = data[:, torque + VOLTAGE] * VOLT
        state.temperature[places] = data[:, torque + TEMPERATURE]
        state.status_time[places] = time
        state.health_time[places] = time
