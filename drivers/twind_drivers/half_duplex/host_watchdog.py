"""Watchdog that the driver keeps for devices without one: who was silent too long gets no goals. Pure.

Such a device holds the last goal that it received. While it is silent the goals go on without it, so that the
next one would be a step. A packet of goals leaves before the reply that shows its return, hence it gets none
while it is silent. From its return it counts as tripped until it is prepared again, as a device whose own
watchdog has tripped. A pause between readings counts for little: no goal leaves meanwhile.
"""

import numpy as np

from twind_drivers.bus import TRIPPED, Bools, SlowRegisterValues
from twind_drivers.flags import every

LIMIT = 0.1  # s of silence, as long as the bus watchdogs of devices that have one ...
PERIODS = 3.5  # ... and no fewer readings: at a low rate one lost reply is no silence


class HostWatchdog:
    """Watchdog of m devices; the tripped ones read `TRIPPED` in `registers.watchdog`.

    `watched` (m,): devices that get goals; the writer sets it. `overdue` (m,): those of them that are silent
    for longer than `limit` (s) now. Times in s, never going back.
    """

    def __init__(self, registers: SlowRegisterValues, period: float) -> None:
        """`period` (s): of the readings."""
        self.limit = max(LIMIT, PERIODS * period)
        self._most = self.limit / PERIODS  # s of silence that one reading without a reply may show
        self.watched: Bools = np.zeros(len(registers.watchdog), np.bool_)
        self.overdue: Bools = np.zeros(len(registers.watchdog), np.bool_)
        self._registers = registers
        self._heard_at = np.full(len(registers.watchdog), np.inf)  # while one is missing
        self._read_at = np.inf  # of the last reading
        self._missing = False

    def record(self, replied: Bools, now: float) -> None:
        """Record the devices (m,) whose replies a cyclic reading holds, at `now`."""
        if not self._missing:
            if every(replied):
                self._read_at = now
                return
            self._missing = True
            self._heard_at.fill(min(self._read_at, now))
        self._heard_at += max(0.0, now - self._read_at - self._most)
        self._read_at = now
        late = (now - self._heard_at > self.limit) & self.watched
        self._registers.watchdog[late & replied] = TRIPPED
        self.overdue = late & ~replied
        if late.any():
            self._registers.version += 1
        self._heard_at[replied] = now
        self._missing = not every(replied)

    def clear(self, devices: Bools) -> None:
        """Release devices (m,) that are prepared: their next goal is where they are."""
        self._registers.watchdog[devices] = -1
        self._registers.version += 1
