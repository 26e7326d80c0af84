"""Statistics of repeated durations: the last 100 values, and the whole run as histograms.

Adding a value costs about a microsecond; statistics are computed on reading. Times are seconds. An unknown
(NaN, inf) or negative duration is never averaged away: it counts as a violation and as too late.
"""

from array import array
from bisect import bisect_left
from collections import deque
from math import ceil, exp, inf, log, nan, sqrt
from typing import NamedTuple

import numpy as np

from twind.robot.arrays import Ints

SIZE = 100  # values of a window
KEPT = 1024  # values of a `RecentValues`: half a second at up to 1000 Hz and beyond
RECENT = 0.5  # s
# the run's quantiles: 1 µs to 9 s in bins 4 % wide
SMALLEST = 1e-6
BINS = 400
STEP = 0.04
_FIRST = log(SMALLEST)
# shares of the run, from which on its quantiles are computed anew: all values added since they were computed,
# and those of them above its p99
GROWN = 0.01
GROWN_ABOVE = 0.0005
BOUNDS_MS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0)
BOUNDS = tuple(bound / 1e3 for bound in BOUNDS_MS)  # s, of the buckets of the interface


class RollingStats:
    """The last 100 values, and the run as a histogram. Unknown statistics are NaN."""

    def __init__(self, threshold: float = inf) -> None:
        self.threshold = threshold  # of the values from now on
        self.now = nan  # the last value; NaN unknown
        self.at = -inf  # s, when it was added
        self.count = 0  # values added in the run, unknown ones included
        self.worst = nan  # of the run
        self.sum = 0.0  # of the run's known values
        self.buckets = [0] * (len(BOUNDS) + 1)  # values of the run at most as large as each bound; the rest
        self._least = nan
        self._figures: RollingFigures | None = None
        self._quantiles = (-1, nan, nan)  # values added when they were computed; p50 and p99 of the run
        self._bin_of_p99 = -1  # -1: the run has no known value
        self._above = 0  # values in bins above that of p99 since it was computed
        # Written one number at a time, which `array` does several times as fast; read through numpy.
        self._ring = array("d", [nan] * SIZE)  # NaN unknown
        self._values = np.frombuffer(self._ring)
        self._late = bytearray(SIZE)  # 1: above the threshold, or unknown
        self._bins = array("q", [0] * BINS)
        self._counts = np.frombuffer(self._bins, np.int64)

    def add(self, value: float, now: float = nan, bound: float | None = None) -> None:
        """Add a value, at time `now` (needed for `at`). `bound`: used in place of the threshold."""
        place = self.count % SIZE
        self.count = self.count + 1
        self.at = now
        if not 0.0 <= value < inf:
            self.now = self._ring[place] = nan
            self._late[place] = 1
            self.buckets[-1] += 1
            return
        self._late[place] = not value <= (self.threshold if bound is None else bound)
        self.sum += value
        self.buckets[bisect_left(BOUNDS, value)] += 1
        self.now = self._ring[place] = value
        if not value <= self.worst:
            self.worst = value
        if not value >= self._least:
            self._least = value
        bin = int((log(value) - _FIRST) / STEP) if value > SMALLEST else 0
        if bin >= BINS:
            bin = BINS - 1
        self._bins[bin] += 1
        if bin > self._bin_of_p99:
            self._above += 1

    @property
    def violations(self) -> int:
        """Values of the window that were above the threshold, or unknown."""
        return self._late.count(1)

    @property
    def mean(self) -> float:
        """Mean of the window's known values."""
        return self.figures().mean

    @property
    def std(self) -> float:
        """Standard deviation of the window's known values."""
        return self.figures().std

    @property
    def min(self) -> float:
        """Smallest of the window's known values."""
        return self.figures().min

    @property
    def max(self) -> float:
        """Largest of the window's known values."""
        return self.figures().max

    @property
    def p50(self) -> float:
        """Median of the run's known values, within 2 %."""
        return self.figures().p50

    @property
    def p99(self) -> float:
        """99 % of the run's known values are below, within 2 %."""
        return self.figures().p99

    def figures(self) -> "RollingFigures":
        """Return all figures as of the last value; they are computed once, however many are read."""
        if self._figures is None or self._figures.values != self.count:
            self._figures = self._work_out()
        return self._figures

    def _work_out(self) -> "RollingFigures":
        p50, p99 = self._of_run()
        total = sum(self._ring)
        if 0.0 <= total < inf:  # all are known
            mean = total / SIZE
            std = sqrt(max(0.0, float(self._values.dot(self._values)) / SIZE - mean * mean))
            return RollingFigures(self.count, mean, std, min(self._ring), max(self._ring), p50, p99)
        valid = self._values[self._values >= 0.0]  # never those that are unknown, or not there yet
        if not len(valid):
            return RollingFigures(self.count, nan, nan, nan, nan, p50, p99)
        mean = float(valid.sum()) / len(valid)
        off = valid - mean
        std = sqrt(float(off @ off) / len(valid))
        return RollingFigures(self.count, mean, std, float(valid.min()), float(valid.max()), p50, p99)

    def _of_run(self) -> tuple[float, float]:
        """Return p50 and p99 of the run.

        They are computed anew when the run has grown by a hundredth, or a burst may have raised p99.
        """
        counted, p50, p99 = self._quantiles
        grown = self.count > counted * (1.0 + GROWN) or self._above > self.count * GROWN_ABOVE
        if counted < 0 or grown:
            seen = self._counts.cumsum()
            p50 = self._middle(_bin(seen, 0.5))
            self._bin_of_p99 = _bin(seen, 0.99)
            p99 = self._middle(self._bin_of_p99)
            self._above = 0
            self._quantiles = (self.count, p50, p99)
        return p50, p99

    def _middle(self, bin: int) -> float:
        """Return the value that stands for those of a bin; NaN for -1."""
        if bin < 0:
            return nan
        middle = SMALLEST * exp((bin + 0.5) * STEP)
        return max(self._least, min(self.worst, middle))


def _bin(seen: Ints, share: float) -> int:
    """Return the bin of the quantile `share`; -1 without values. `seen`: values of the run up to each bin."""
    if not seen[-1]:
        return -1
    # At least one value: the share 0 is the first bin that has any.
    return int(seen.searchsorted(max(share * float(seen[-1]), 1.0)))


class RecentValues:
    """The values of the last half second, for their 95 % quantile."""

    def __init__(self) -> None:
        self._values: deque[tuple[float, float]] = deque(maxlen=KEPT)  # (s, value), inf unknown

    def add(self, value: float, now: float) -> None:
        """Add a value at `now` (s)."""
        self._values.append((now, value if 0.0 <= value < inf else inf))

    def p95(self, now: float) -> float:
        """Return the value that 95 % of the last half second do not exceed; unknown values count as inf.

        NaN without values.
        """
        values = sorted(value for time, value in self._values if 0.0 <= now - time <= RECENT)
        return values[ceil(0.95 * len(values)) - 1] if values else nan


class RollingFigures(NamedTuple):
    """Statistics of a window at the time when `values` values had been added."""

    values: int
    mean: float
    std: float
    min: float
    max: float
    p50: float
    p99: float
