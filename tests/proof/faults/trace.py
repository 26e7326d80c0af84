"""Motion of the servos, tick after tick: registers and shafts, read from inside, not from reports."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tests.support.daemon_rig import Rig

KEYS = ("goal_position", "torque_enable", "bus_watchdog")


class Trace:
    """Rows in time: goal, torque, watchdog (as in the registers) and shaft (ticks), bus after bus."""

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self.time: list[float] = []
        self._ours: list[NDArray[np.bool_]] = []
        self._goal: list[NDArray[np.int64]] = []
        self._torque: list[NDArray[np.int64]] = []
        self._watchdog: list[NDArray[np.int64]] = []
        self._place: list[NDArray[np.float64]] = []

    def look(self) -> None:
        """Note what is so now."""
        rig = self._rig
        self.time.append(rig.clock.now())
        self._place.append(rig.counts)
        self._ours.append(np.array([rig.loop.torque.armed or rig.loop.torque.energising]))
        self._goal.append(rig.register("goal_position").astype(np.int64))
        self._torque.append(rig.register("torque_enable").astype(np.int64))
        self._watchdog.append(rig.register("bus_watchdog").astype(np.int64))

    def _span(self, rows: list[NDArray], since: float, until: float) -> NDArray:
        first, last = np.searchsorted(self.time, [since - 1e-9, until + 1e-9])
        found = rows[first:last]
        return np.array(found) if found else np.empty((0, *self._goal[0].shape))

    def goal(self, since: float, until: float = np.inf) -> NDArray:
        """(k, m) goal registers."""
        return self._span(self._goal, since, until)

    def torque(self, since: float, until: float = np.inf) -> NDArray:
        """(k, m) torque enable."""
        return self._span(self._torque, since, until)

    def watchdog(self, since: float, until: float = np.inf) -> NDArray:
        """(k, m) bus watchdog."""
        return self._span(self._watchdog, since, until)

    def ours(self, since: float, until: float = np.inf) -> NDArray:
        """(k, 1) the daemon says that torque is its own."""
        return self._span(self._ours, since, until)

    def place(self, since: float, until: float = np.inf) -> NDArray:
        """(k, m) shafts, ticks."""
        return self._span(self._place, since, until)
