"""Presence of the devices of a bus: a device that misses several requests is parked and probed. Pure."""

import numpy as np

from twind_drivers.bus import Bools

MISSES = 3  # missed replies in a row after which a device is parked; 1 would park it for one bit error
FIRST = 0.03  # s from parking to the first probe: three cycles of noise at 100 Hz are no dead servo
PROBE = 1.0  # s, longest time between probes; it doubles up to this, since a missed probe costs its timeout


class DevicePresence:
    """Presence of m devices. `asked` (m,): devices not parked; read-only, and replaced at each change.

    One dead device must not cost the others their fast read, nor every cycle its timeout. A reading without
    any reply parks no device: then the whole bus is silent, and all devices stay in the request.
    """

    def __init__(self, count: int) -> None:
        self.asked = _frozen(np.ones(count, np.bool_))
        self.parked = False  # at least one device is left out
        self._misses = np.zeros(count, np.int64)
        self._due = np.full(count, np.inf)  # s, next probe of the parked
        self._pause = np.full(count, FIRST)  # s, from its last probe to the next
        self._back_at = np.full(count, -np.inf)  # s, time of each device's return

    def record_complete_reply(self) -> None:
        """Record a reading in which every device in the request replied."""
        self._misses.fill(0)

    def record_missing_reply(self, replied: Bools, could: Bools, now: float) -> bool:
        """Record a reading with missing replies; return True if it parks a device.

        `replied` (m,): devices that replied. `could` (m,): devices that were able to. In a fast reply the
        devices behind the first missing one are not able to.
        """
        if not replied.any():
            return False
        self._misses[replied] = 0
        self._misses[could & ~replied] += 1
        gone = self.asked & (self._misses >= MISSES)
        if not gone.any():
            return False
        self.asked = _frozen(self.asked & ~gone)
        self.parked = True
        anew = now - self._back_at > PROBE  # else the device is intermittent and keeps its longer pause
        self._pause[gone & anew] = FIRST
        self._due[gone] = now + self._pause[gone]
        return True

    def due(self, now: float) -> int | None:
        """Return the index of a parked device whose probe is due; None: none."""
        if not self.parked:
            return None
        place = int(self._due.argmin())
        return place if self._due[place] <= now else None

    def probed(self, place: int, now: float) -> None:
        """Record that the probe of a device leaves now; the next one follows after a longer pause."""
        self._pause[place] = min(2.0 * self._pause[place], PROBE)
        self._due[place] = now + self._pause[place]

    def back(self, place: int, now: float) -> None:
        """Record the reply of a parked device: it is in the request again.

        The other parked devices are probed at once, since a common cause (supply, connector) may be gone.
        """
        requested = self.asked.copy()
        requested[place] = True
        self.asked = _frozen(requested)
        self.parked = not requested.all()
        self._misses[place] = 0
        self._due[place] = np.inf
        self._back_at[place] = now
        self._due[~requested] = now


def _frozen(flags: Bools) -> Bools:
    flags.setflags(write=False)
    return flags
