"""Which devices of a bus are asked: who stays silent again and again is parked, and probed. Pure."""

import numpy as np

from twind_drivers.bus import Bools

MISSES = 3  # cycles in a row that a device was asked, could have been heard, and was not
FIRST = 0.03  # s until a device that was just parked is probed: a burst of noise is no dead servo
PROBE = 1.0  # s between probes of one that stays silent; each time twice as long until then


class DevicePresence:
    """The roll of m devices. `asked` (m,) is read-only and replaced, never changed.

    One dead device must not cost the others their fast read, nor every cycle its timeout. Nobody is parked
    by a reading that nobody answered: then it is the bus that is silent, and everybody goes on being asked.
    """

    def __init__(self, count: int) -> None:
        self.asked = _frozen(np.ones(count, np.bool_))
        self.parked = False  # somebody is left out
        self._misses = np.zeros(count, np.int64)
        self._due = np.full(count, np.inf)  # s, next probe of the parked
        self._pause = np.full(count, FIRST)  # s, from its last probe to the next
        self._back_at = np.full(count, -np.inf)  # s, when each came back

    def record_complete_reply(self) -> None:
        """Everybody who was asked answered."""
        self._misses.fill(0)

    def record_missing_reply(self, heard: Bools, could: Bools, now: float) -> bool:
        """A reading with a hole. True: somebody is parked now.

        `heard` (m,): who was; `could` (m,): who could have been. In a fast reply those
        behind the first hole could not.
        """
        if not heard.any():
            return False
        self._misses[heard] = 0
        self._misses[could & ~heard] += 1
        gone = self.asked & (self._misses >= MISSES)
        if not gone.any():
            return False
        self.asked = _frozen(self.asked & ~gone)
        self.parked = True
        anew = now - self._back_at > PROBE  # else it comes and goes, and its last probe made the pause longer
        self._pause[gone & anew] = FIRST
        self._due[gone] = now + self._pause[gone]
        return True

    def due(self, now: float) -> int | None:
        """Place of a parked device whose probe is due."""
        if not self.parked:
            return None
        place = int(self._due.argmin())
        return place if self._due[place] <= now else None

    def probed(self, place: int, now: float) -> None:
        """Its probe leaves now; the next one comes later, answered or not."""
        self._pause[place] = min(2.0 * self._pause[place], PROBE)
        self._due[place] = now + self._pause[place]

    def back(self, place: int, now: float) -> None:
        """A parked device answered: it is asked again, and the other parked ones are probed at once."""
        asked = self.asked.copy()
        asked[place] = True
        self.asked = _frozen(asked)
        self.parked = not asked.all()
        self._misses[place] = 0
        self._due[place] = np.inf
        self._back_at[place] = now
        self._due[~asked] = now


def _frozen(flags: Bools) -> Bools:
    flags.setflags(write=False)
    return flags
