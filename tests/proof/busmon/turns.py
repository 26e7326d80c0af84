"""Servos whose counts may be whole turns away from those of their calibration: power-off forgets how many."""

import numpy as np

from tests.proof.busmon.limits import Limits
from tests.proof.busmon.shadow import Servos

ONE_TURN = 3  # the operating mode that knows no other


class Turning(Servos):
    """Ranges go with the turn on which a servo was read while it had no torque."""

    def __init__(self, limits: Limits) -> None:
        super().__init__(limits)
        known = [limits.servos[id] for id in self.ids]
        self._range = np.array([self.lower, self.upper])
        self._middle = np.array([servo.middle for servo in known])
        self._turn = np.array([servo.turn for servo in known], np.int64)
        self.mode = np.array([servo.mode for servo in known])  # as written, or read
        self.shift = np.zeros(len(known), np.int64)  # counts

    def at(self, now: float, rows: np.ndarray, positions: np.ndarray) -> None:
        """Positions were read. The turn is that on which a place is nearest to the middle of its travel."""
        if self.lost.any() or not self.on.all():
            limp = ~self.on[rows] | self.lost[rows]
            who = rows[limp]
            where = positions[limp]
            turns = np.round((where - self._middle[who]) / self._turn[who]).astype(np.int64)
            self.shift[who] = np.where(self.mode[who] == ONE_TURN, 0, turns * self._turn[who])
            self.lower, self.upper = self._range + self.shift
        super().at(now, rows, positions)
