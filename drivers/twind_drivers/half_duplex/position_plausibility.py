"""Plausibility of positions behind a weak checksum. Pure.

One damaged packet in some 20 to 256 has a sound checksum. Positions whose two bytes add up to 256 have the
checksum of 0: two lost bytes make a sound packet of position 0. So a position must continue the motion of the
last two believed ones. One that does not counts as not received, and is believed when the readings of the
next cycles agree with it: one within reach of the last, after a gap, and more beyond it, whatever its age.
"""

from dataclasses import replace

import numpy as np

from twind_drivers.bus import Bools, BusSample, Ints

FASTEST = 6_000.0  # counts/s: no known model is faster (STS3250: 75 rpm); a faster hand costs readings
MARGIN = 32  # counts, of noise and play
CHANGE = 0.5  # share of the fastest speed by which the speed may change in a cycle, as at an impact
LONGEST = 3.0  # periods: a cycle that took longer extends the reach no further
AFTER_GAP = 2  # readings that agree, of consecutive cycles: within reach of the last one
AGREE = 4  # likewise, beyond reach: of 3, noise makes some in 10^6 packets that are all damaged
ZERO = 8  # likewise, of position 0, which lost bytes make most often
UNKNOWN = 1 << 40  # counts: before the first position


class PositionPlausibility:
    """Last believed positions of m devices. `period` (s): of the reading."""

    def __init__(self, count: int, period: float) -> None:
        self._longest = LONGEST * period
        self._received = 0.0
        self._last: Ints = np.full(count, UNKNOWN, np.int64)  # believed last
        self._expected: Ints = self._last  # of this cycle, if the motion continues
        self._followed: Bools = np.zeros(count, np.bool_)  # believed in the cycle before
        self._before: Ints = self._last  # reading of the cycle before
        self._seen: Ints = np.zeros(count, np.int64)  # cycles in a row with readings that agree
        self._waiting = False  # a reading waits for the next one to agree

    def filter(self, sample: BusSample) -> BusSample:
        """Return the sample without positions that are not plausible: those devices count as not received."""
        way = FASTEST * min(sample.received - self._received, self._longest)
        self._received = sample.received
        heard = sample.heard
        position = sample.position
        regular = (np.abs(position - self._expected) <= CHANGE * way + MARGIN) & self._followed
        if self._waiting or np.count_nonzero(heard & ~regular):
            believed = self._judge(sample, regular, way + MARGIN)
            if not np.array_equal(believed, heard):
                sample = _without(sample, believed)
            heard = believed
        if heard.all():
            self._last = position
        else:
            self._last = np.where(heard, position, self._last)
        self._expected = 2 * position - self._before
        self._followed = heard
        self._before = position
        return sample

    def _judge(self, sample: BusSample, regular: Bools, reach: float) -> Bools:
        """Return the devices (m,) whose position is believed."""
        position = sample.position
        near = np.abs(position - self._last) <= reach
        needed = np.where(near, AFTER_GAP, np.where(position == 0, ZERO, AGREE))
        # The first one needs none here: the daemon chooses the turn of a joint by several readings.
        needed[regular | ((self._last == UNKNOWN) & (position != 0))] = 1
        same = np.abs(position - self._before) <= reach
        self._before = np.where(same, self._before, position)
        seen = np.where(sample.heard, np.where(same, self._seen, 0) + 1, 0)
        believed: Bools = seen >= needed
        self._seen = np.where(believed, 0, seen)
        self._waiting = bool(self._seen.any())
        return believed


def _without(sample: BusSample, fresh: Bools) -> BusSample:
    told = None if sample.effort_told is None else sample.effort_told & fresh
    return replace(
        sample,
        heard=fresh,
        position=np.where(fresh, sample.position, 0),
        velocity=np.where(fresh, sample.velocity, 0),
        effort=np.where(fresh, sample.effort, 0),
        error=np.where(fresh, sample.error, 0).astype(np.uint8),
        effort_told=told,
    )
