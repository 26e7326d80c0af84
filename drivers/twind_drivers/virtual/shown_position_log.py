"""History of the servos' positions with time, against which a host's reading is checked."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

MOST = 100_000  # readings


class ShownPositionLog:
    """A ring of the last readings of m servos: every value that the present position registers ever held."""

    def __init__(self, servos: int, size: int) -> None:
        """Make the history of `size` readings. Raises ValueError outside 1..100,000."""
        if not 1 <= size <= MOST:
            raise ValueError(f"record: {size} readings are outside 1..{MOST}")
        self._time = np.full(size, np.nan)
        self._position = np.zeros((size, servos), np.int64)
        self._count = 0

    def note(self, now: float, position: NDArray[Any]) -> None:
        """The present position registers (m,) were refreshed at `now`, s."""
        at = self._count % len(self._time)
        self._time[at] = now
        self._position[at] = position
        self._count += 1

    def readings(self) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Times (k,), s, ascending, and positions (k, m), ticks in the register's frame."""
        size = len(self._time)
        if self._count <= size:
            return self._time[: self._count].copy(), self._position[: self._count].copy()
        turn = -(self._count % size)
        return np.roll(self._time, turn), np.roll(self._position, turn, axis=0)
