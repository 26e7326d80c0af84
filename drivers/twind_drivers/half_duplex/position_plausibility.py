"""Plausibility of positions behind a weak checksum. Pure.

Positions whose two bytes add up to 256 have the checksum of 0: two lost bytes make a sound packet of position
0. A position must therefore be within reach of the last one. One that is not counts as not received, and is
believed when the next two readings of the device agree with it.
"""

from dataclasses import replace

import numpy as np

from twind_drivers.bus import Bools, BusSample, Ints

FASTEST = 6_000.0  # counts/s: no known model is faster (STS3250: 75 rpm); a faster hand costs a reading
MARGIN = 32  # counts, of noise and play
AGREE = 3  # readings in a row; of two, noise makes a pair in 4 % of the wrong ones
UNKNOWN = 1 << 40  # counts: before the first position


class PositionPlausibility:
    """Last believed positions of m devices. `period` (s): of the reading."""

    def __init__(self, count: int, period: float) -> None:
        self._usual = FASTEST * period + MARGIN
        self._last: Ints = np.full(count, UNKNOWN, np.int64)
        self._time = np.zeros(count)
        self._candidate: Ints = np.full(count, UNKNOWN, np.int64)  # dropped last, until one is believed
        self._candidate_time = np.zeros(count)
        self._seen = np.zeros(count, np.int64)  # times in a row that the candidate was seen
        self._waiting = False  # there is a candidate
        self._count = count

    def filter(self, sample: BusSample) -> BusSample:
        """Return the sample without positions that are not plausible: those devices count as not received."""
        heard = sample.heard
        far = heard & (np.abs(sample.position - self._last) > self._usual)
        if self._waiting:  # a plausible reading in between: it came from nowhere
            self._seen[heard & ~far] = 0
            self._waiting = bool(self._seen.any())
        if np.count_nonzero(far):
            dropped = self._judge(sample, far)
            if np.count_nonzero(dropped):
                heard = heard & ~dropped
                sample = _without(sample, heard)
        if np.count_nonzero(heard) == self._count:
            self._last = sample.position
            self._time.fill(sample.received)
        else:
            self._last = np.where(heard, sample.position, self._last)
            self._time[heard] = sample.received
        return sample

    def _judge(self, sample: BusSample, far: Bools) -> Bools:
        """Return the devices (m,) whose position is dropped."""
        dropped = np.zeros(self._count, np.bool_)
        for row in np.flatnonzero(far).tolist():
            position = int(sample.position[row])
            last = int(self._last[row])
            reach = FASTEST * (sample.received - self._time[row]) + MARGIN
            agreed = FASTEST * (sample.received - self._candidate_time[row]) + MARGIN
            plausible = position != 0 and (last == UNKNOWN or abs(position - last) <= reach)
            same = abs(position - int(self._candidate[row])) <= min(agreed, self._usual)
            seen = int(self._seen[row]) + 1 if same else 1
            self._seen[row] = 0
            if not plausible and seen < AGREE:
                dropped[row] = self._waiting = True
                self._seen[row] = seen
                self._candidate[row] = position
                self._candidate_time[row] = sample.received
        return dropped


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
