"""Plausibility of positions behind a weak checksum. Pure.

Positions whose two bytes add up to 256 have the checksum of 0: two lost bytes make a sound packet of position
0. A position must therefore be within reach of the last one. One that is not counts as not received, and is
believed when the next reading agrees with it.
"""

from dataclasses import replace

import numpy as np

from twind_drivers.bus import Bools, BusSample, Ints

FASTEST = 10_000.0  # counts/s: no Feetech servo is faster, nor a hand that turns one
MARGIN = 64  # counts, of noise and play
UNKNOWN = 1 << 40  # counts: before the first position


class PositionPlausibility:
    """Last believed positions of m devices. `period` (s): of the reading."""

    def __init__(self, count: int, period: float) -> None:
        self._usual = FASTEST * period + MARGIN
        self._last: Ints = np.full(count, UNKNOWN, np.int64)
        self._time = np.zeros(count)
        self._candidate: Ints = np.full(count, UNKNOWN, np.int64)  # dropped last, until one is believed
        self._candidate_time = np.zeros(count)
        self._count = count

    def filter(self, sample: BusSample) -> BusSample:
        """Return the sample without positions that are not plausible: those devices count as not received."""
        heard = sample.heard
        far = heard & (np.abs(sample.position - self._last) > self._usual)
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
            if plausible or abs(position - int(self._candidate[row])) <= min(agreed, self._usual):
                self._candidate[row] = UNKNOWN
            else:
                dropped[row] = True
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
