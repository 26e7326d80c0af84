"""Plausible positions of a bus (SENSE_JUMP): no motor turns further between two than its speed allows.

Pure; in ticks only. An impossible position means a servo that lost a turn, a slipped horn, or a stray reply.
"""

from math import inf

import numpy as np

from twind.robot.arrays import Bools, Floats, Ints, every

REACH = 1.5  # share of the motor's fastest speed
TICKS = 3.0  # ticks that a reading may flicker
AGREEING = 3  # readings in a row that agree with each other: then the joint really is there
NOMINAL = 0.8  # share of a period: the shortest usual time between two readings


class PlausibilityFilter:
    """Judges the positions (m,) of one bus, one exchange after the other."""

    def __init__(self, fastest: Floats, period: float) -> None:
        """`fastest` (m,): ticks/s that each motor turns at most; `period` (s) between two exchanges."""
        self._reach = REACH * fastest
        self._least = NOMINAL * period
        near = self._reach * self._least + TICKS
        self._near = np.floor(near).astype(np.int64)  # ticks, within the shortest usual time
        count = len(fastest)
        self.jumps: Ints = np.zeros(count, np.int64)  # in a row, up to the last reading; 0: it fits
        self.leaps: Ints = np.zeros(count, np.int64)  # ticks, how far the last reading was off
        self._row = np.zeros(count, np.int64)
        self._agreeing = np.zeros(count, np.int64)
        self._place: Ints = np.zeros(count, np.int64)  # the last accepted position, ...
        self._at = np.full(count, -inf)  # s, ... and when it was requested; -inf never
        self._other: Ints = np.zeros(count, np.int64)  # the last rejected position, ...
        self._other_at = np.full(count, -inf)
        self._whole = -inf  # s, when the last exchange was requested; -inf: not all of it fitted

    def usual(self, position: Ints, sent: float, received: float) -> bool:
        """Accept the healthy case: all replied, now and before, and none moved further than it can."""
        if not inf > received - self._whole >= self._least:
            return False
        if not every(np.abs(position - self._place) <= self._near):
            return False
        self._place = position
        self._whole = sent
        return True

    def believe(self, position: Ints, fresh: Bools, sent: float, received: float, limp: Bools) -> Bools:
        """Mark motors (m,) that replied with a plausible position.

        `jumps` and `leaps` describe the others.

        The time between two readings is at most from the request of one to the end of the other. `limp` (m,):
        torque is read back off, so a hand may move the joint faster than the motor. Such a reading is
        accepted, and reported.
        """
        if self._whole > -inf:
            self._at[:] = self._whole
        leap = np.abs(position - self._place)
        fits = fresh & (leap <= self._reach * (received - self._at) + TICKS)
        wild = fresh & ~fits
        near = np.abs(position - self._other) <= self._reach * (received - self._other_at) + TICKS
        self._agreeing = np.where(wild, np.where(near, self._agreeing, 0) + 1, self._agreeing)
        self._row = np.where(wild, self._row + 1, self._row)
        self.jumps = np.where(wild, self._row, 0)
        self.leaps = np.where(wild, leap, 0)
        self._other = np.where(wild, position, self._other)
        self._other_at = np.where(wild, sent, self._other_at)
        believed: Bools = fits | (wild & (limp | (self._agreeing >= AGREEING)))
        self._place, self._at = np.where(believed, position, self._place), np.where(believed, sent, self._at)
        self._row[believed] = self._agreeing[believed] = 0
        self._whole = sent if every(fits) else -inf
        return believed
