"""Slow registers of a Feetech bus: torque, error, supply and temperature, in one block. Pure."""

import numpy as np

from twind_drivers.bus import Ints, ReadRequest
from twind_drivers.half_duplex.pending_reply import Octets
from twind_drivers.half_duplex.slow_register_slices import SlowRegisterSlices

BLOCK = (40, 26)  # address, size: torque switch .. status; the same in all maps
VOLTAGE = 62 - 40
TEMPERATURE = 63 - 40
STATUS = 65 - 40
VOLT = 0.1  # V per raw unit
COMMON = {0x01: 0x01, 0x02: 0x08, 0x04: 0x04, 0x08: 0x20, 0x20: 0x20}  # of a fault: the bit that names it


class FeetechSlowRegisters(SlowRegisterSlices):
    """Slow registers of each id with the time of reading."""

    def __init__(self, ids: tuple[int, ...]) -> None:
        super().__init__(ids, BLOCK)
        self._common = np.array([sum({COMMON[bit] for bit in COMMON if raw & bit}) for raw in range(256)])

    def _store(self, query: ReadRequest, data: Octets, places: Ints, time: float) -> None:
        state = self.registers
        torque = BLOCK[0] - query.address
        if not 0 <= torque < query.size:
            return
        state.torque[places] = data[:, torque] == 1
        if torque + STATUS < query.size:
            state.fault[places] = self._common[data[:, torque + STATUS]]
            state.voltage[places] = data[:, torque + VOLTAGE] * VOLT
            state.temperature[places] = data[:, torque + TEMPERATURE]
            state.status_time[places] = time
            state.health_time[places] = time
