"""Slow registers of a Feetech bus: torque, error, supply and temperature, in one block. Pure."""

from collections.abc import Sequence

import numpy as np

from twind_drivers.bus import ReadRequest, SlowRegisterValues
from twind_drivers.half_duplex.pending_reply import Octets

BLOCK = (40, 26)  # address, size: torque switch .. status; the same in all maps
VOLTAGE = 62 - 40
TEMPERATURE = 63 - 40
STATUS = 65 - 40
VOLT = 0.1  # V per raw unit
COMMON = {0x01: 0x01, 0x02: 0x08, 0x04: 0x04, 0x08: 0x20, 0x20: 0x20}  # of a fault: the bit that names it
ROUNDS_HZ = 20.0  # refreshes of each device a second, at least


class FeetechSlowRegisters:
    """Slow registers of each id with the time of reading. `watchdog` stays unknown: there is none."""

    def __init__(self, ids: tuple[int, ...]) -> None:
        self.registers = SlowRegisterValues.unknown(len(ids))
        self._index = {id: place for place, id in enumerate(ids)}
        self._slices: list[ReadRequest] = []
        self._first: list[ReadRequest] = []
        self._turn = 0
        self._slots = 1
        self._common = np.array([sum({COMMON[bit] for bit in COMMON if raw & bit}) for raw in range(256)])

    def schedule(self, ids: Sequence[int], slots: int, most: int) -> list[ReadRequest]:
        """Schedule slices of these `ids` round robin, in `slots` calls or more; return them.

        `most`: devices that one slice has time for.
        """
        size = min(max(1, -(-len(ids) // slots)), most)
        parts = [tuple(ids[first : first + size]) for first in range(0, len(ids), size)]
        self._slices = [ReadRequest(part, *BLOCK) for part in parts]
        self._slots = max(slots, len(parts))
        self._turn = 0
        return self._slices

    def ask_first(self, id: int) -> None:
        """Schedule a returned device first: it may have lost its supply, and its torque."""
        self._first.append(ReadRequest((id,), *BLOCK))

    def next(self, *, narrow: bool = False) -> ReadRequest | None:
        """Return the next slice; None: nothing is due in this turn. `narrow` changes nothing here."""
        if self._first:
            return self._first.pop(0)
        turn = self._turn
        self._turn = (turn + 1) % self._slots
        return self._slices[turn] if turn < len(self._slices) else None

    def update_from_replies(self, query: ReadRequest, ids: Sequence[int], data: Octets, time: float) -> None:
        """Store the registers from the replies of `ids` (k) to `query`, `data` (k, size) bytes."""
        state = self.registers
        state.version += 1
        known = [(row, self._index[id]) for row, id in enumerate(ids) if id in self._index]
        torque = BLOCK[0] - query.address
        if not known or not 0 <= torque < query.size:
            return
        rows = np.array([row for row, _ in known], np.intp)
        places = np.array([place for _, place in known], np.intp)
        state.torque[places] = data[rows, torque] == 1
        if torque + STATUS < query.size:
            state.fault[places] = self._common[data[rows, torque + STATUS]]
            state.voltage[places] = data[rows, torque + VOLTAGE] * VOLT
            state.temperature[places] = data[rows, torque + TEMPERATURE]
            state.status_time[places] = time
            state.health_time[places] = time

    def forget(self, id: int) -> None:
        """Reset the values of a restarted device to unknown."""
        place = self._index[id]
        state = self.registers
        state.version += 1
        state.torque[place] = state.fault[place] = -1
        state.voltage[place] = state.temperature[place] = np.nan
        state.status_time[place] = state.health_time[place] = -np.inf
