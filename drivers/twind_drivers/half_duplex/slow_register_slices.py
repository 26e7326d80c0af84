"""Slow registers of a bus: one block of each device, in slices round robin. Pure."""

from collections.abc import Sequence

import numpy as np

from twind_drivers.bus import ReadRequest, SlowRegisterValues
from twind_drivers.half_duplex.pending_reply import Octets

ROUNDS_HZ = 20.0  # refreshes of each device a second, at least


class SlowRegisterSlices:
    """Slow registers of each id with the time of reading. `block`: address and size.

    `watchdog` stays unknown: the devices have none. A family decodes its rows.
    """

    def __init__(self, ids: tuple[int, ...], block: tuple[int, int]) -> None:
        self.registers = SlowRegisterValues.unknown(len(ids))
        self.block = block
        self._index = {id: place for place, id in enumerate(ids)}
        self._slices: list[ReadRequest] = []
        self._first: list[ReadRequest] = []
        self._turn = 0
        self._slots = 1

    def schedule(self, ids: Sequence[int], slots: int, most: int) -> list[ReadRequest]:
        """Schedule slices of these `ids` round robin, in `slots` calls or more; return them.

        `most`: devices that one slice has time for.
        """
        size = min(max(1, -(-len(ids) // slots)), most)
        parts = [tuple(ids[first : first + size]) for first in range(0, len(ids), size)]
        self._slices = [ReadRequest(part, *self.block) for part in parts]
        self._slots = max(slots, len(parts))
        self._turn = 0
        return self._slices

    def ask_first(self, id: int) -> None:
        """Schedule a returned device first: it may have lost its supply, and its torque."""
        self._first.append(ReadRequest((id,), *self.block))

    def next(self, *, narrow: bool = False) -> ReadRequest | None:
        """Return the next slice; None: nothing is due in this turn. `narrow` changes nothing here."""
        if self._first:
            return self._first.pop(0)
        turn = self._turn
        self._turn = (turn + 1) % self._slots
        return self._slices[turn] if turn < len(self._slices) else None

    def update_from_replies(self, query: ReadRequest, ids: Sequence[int], data: Octets, time: float) -> None:
        """Store the registers from the replies of `ids` (k) to `query`, `data` (k, size) bytes."""
        self.registers.version += 1
        known = [(row, self._index[id]) for row, id in enumerate(ids) if id in self._index]
        if known:
            rows = np.array([row for row, _ in known], np.intp)
            places = np.array([place for _, place in known], np.intp)
            self._store(query, data[rows], places, time)

    def forget(self, id: int) -> None:
        """Reset the values of a restarted device to unknown."""
        place = self._index[id]
        state = self.registers
        state.version += 1
        state.torque[place] = state.fault[place] = -1
        state.voltage[place] = state.temperature[place] = np.nan
        state.status_time[place] = state.health_time[place] = -np.inf

    def _store(self, query: ReadRequest, data: Octets, places: np.ndarray, time: float) -> None:
        """Store the registers of the devices at `places` (k), `data` (k, size)."""
        raise NotImplementedError
