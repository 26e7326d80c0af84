"""A joint that is driven against its stop (FindStop): what may go out in the state in which nobody arms.

One servo alone has torque, in current-based position mode, its goal current capped; its goals are slow and
end a little beyond where the robot file says that the stop is. All of it is seen in the bytes.
"""

import numpy as np

from tests.proof.busmon.limits import Limits
from tests.proof.busmon.turns import Turning

CAPPED = 5  # operating mode
# registers
MODE = 11
CURRENT = 102
STATE = "calibrating"
LATE = 0.1  # s that a goal may make good at once: then the search has ended by itself


class Search:
    """Known modes and caps. Arrays (m,) in order of ids."""

    def __init__(self, limits: Limits, servos: Turning) -> None:
        known = [limits.servos[id] for id in servos.ids]
        self._servos = servos
        self._since = np.full(len(known), -np.inf)
        self._ends = np.array([servo.stops for servo in known], np.int64)
        self._speed = np.array([servo.slow for servo in known])
        self._weak = np.array([servo.weak for servo in known])
        self._cap = np.full(len(known), -1, np.int64)  # as it was written; -1: it was not

    def written(self, row: int, address: int, data: bytes) -> None:
        """Modes and caps. A mode that changes resets the cap."""
        if address <= MODE < address + len(data):
            self._servos.mode[row] = data[MODE - address]
            self._cap[row] = -1
        if address == CURRENT and len(data) == 2:
            self._cap[row] = int.from_bytes(data, "little")

    def read(self, row: int, address: int, data: bytes) -> None:
        """A mode that was read."""
        if address <= MODE < address + len(data):
            self._servos.mode[row] = data[MODE - address]

    def wrong(self, row: int) -> str:
        """Why this servo may have neither goals nor torque now; empty: it may (W5)."""
        servos = self._servos
        others = [id for id, on in zip(servos.ids, servos.on.tolist(), strict=True) if on]
        if set(others) - {servos.ids[row]}:
            return f"while ids {others} have torque"
        if servos.mode[row] != CAPPED:
            return f"in mode {servos.mode[row]}: no current is capped"
        if not 0 < self._cap[row] <= self._weak[row]:
            return f"with goal current {self._cap[row]}, {self._weak[row]} at most"
        return ""

    def goal(self, row: int, word: int, now: float) -> str:
        """Fault of a goal of a search, except its first: W1 or W3, and how; empty: none."""
        servos = self._servos
        lower, upper = (self._ends[row] + servos.shift[row]).tolist()
        passed = min(max(now - self._since[row], 0.0), LATE)
        self._since[row] = now
        if not lower <= word <= upper:
            return f"W1 goal {word} outside {lower}..{upper}, a search included"
        most = self._speed[row] * passed + 1.0 + 1e-6
        moved = abs(word - int(servos.goal[row]))
        if servos.known[row] and not servos.anew[row] and not servos.first[row] and moved > most:
            return f"W3 goal {word}, {moved} counts from {servos.goal[row]}, {most:.1f} allowed in a search"
        return ""
