"""How late things are: a window per bus and per hop, the state's latency, and whether anybody still answers.

Adding a value costs about a microsecond; statistics are worked out when somebody asks. Times are seconds.
An unknown (NaN, inf) or negative duration is never averaged away: it counts as a violation and as too late.
"""

from array import array
from collections import deque
from collections.abc import Mapping, Sequence
from math import ceil, exp, inf, isfinite, log, nan, sqrt
from typing import Protocol

import numpy as np

from twind.robot.arrays import Floats, some
from twind.robot.finding import Code, Finding
from twind.robot.state import JointState

SIZE = 100  # values of a window
KEPT = 1024  # values with their time, for a share of the last half second at up to 1000 Hz and beyond
RECENT = 0.5  # s
SMALLEST, BINS, STEP = 1e-6, 400, 0.04  # the run's histogram: 1 µs to 9 s in bins 4 % wide
HOPS = ("request", "reply", "state", "twin")  # way of a reading: sent, first byte, last byte, state, twin
LATENCY = 0.05  # s, warned of above (design 6.4)
CALM = 0.8  # of the threshold: the latency must fall below this share ...
CALM_FOR = 1.0  # s ... for this long before it is warned of again
SILENT = 2.0  # s without an answer: disconnected


class Window:
    """The last 100 values, and the run as a histogram. What is not known yet is NaN."""

    def __init__(self, threshold: float = inf) -> None:
        self.threshold = threshold
        self.now = nan  # the last value; NaN unknown
        self.count = 0  # values added in the run, unknown ones included
        self.worst = nan  # of the run
        self._least = nan
        # Written one number at a time, which `array` does several times as fast; read through numpy.
        self._ring = array("d", [nan] * SIZE)  # NaN unknown
        self._values = np.frombuffer(self._ring)
        self._recent: deque[tuple[float, float]] = deque(maxlen=KEPT)  # (s, value), inf unknown
        self._bins = array("q", [0] * BINS)
        self._counts = np.frombuffer(self._bins, np.int64)

    def add(self, value: float, now: float = nan) -> None:
        """One more value, at `now` (needed only for `p95`)."""
        place, self.count = self.count % SIZE, self.count + 1
        if not 0.0 <= value < inf:
            self.now = self._ring[place] = nan
            self._recent.append((now, inf))
            return
        self.now = self._ring[place] = value
        self._recent.append((now, value))
        if not value <= self.worst:
            self.worst = value
        if not value >= self._least:
            self._least = value
        bin = int(log(value / SMALLEST) / STEP) if value > SMALLEST else 0
        self._bins[min(bin, BINS - 1)] += 1

    @property
    def violations(self) -> int:
        """Values of the window above the threshold, or unknown."""
        values = self._values[: self.count]
        return len(values) - int(np.count_nonzero(values <= self.threshold))

    @property
    def mean(self) -> float:
        """Of the window's known values."""
        known = self._known()
        return float(known.sum()) / len(known) if len(known) else nan

    @property
    def std(self) -> float:
        """Standard deviation of the window's known values."""
        known = self._known()
        if not len(known):
            return nan
        off = known - known.sum() / len(known)
        return sqrt(float(off @ off) / len(known))

    @property
    def min(self) -> float:
        """Of the window's known values."""
        known = self._known()
        return float(known.min()) if len(known) else nan

    @property
    def max(self) -> float:
        """Of the window's known values."""
        known = self._known()
        return float(known.max()) if len(known) else nan

    @property
    def p50(self) -> float:
        """Median of the run's known values, within 2 %."""
        return self._quantile(0.5)

    @property
    def p99(self) -> float:
        """99 % of the run's known values are below, within 2 %."""
        return self._quantile(0.99)

    def p95(self, now: float, span: float = RECENT) -> float:
        """95 % of the values of the last `span` s are at most this; unknown ones count as inf.

        NaN when there were none.
        """
        values = sorted(value for time, value in self._recent if 0.0 <= now - time <= span)
        return values[ceil(0.95 * len(values)) - 1] if values else nan

    def _known(self) -> Floats:
        return self._values[self._values >= 0.0]  # never those that are unknown, or not there yet

    def _quantile(self, share: float) -> float:
        seen = self._counts.cumsum()
        if not seen[-1]:
            return nan
        # At least one value: the share 0 is the first bin that has any.
        bin = int(seen.searchsorted(max(share * float(seen[-1]), 1.0)))
        middle = SMALLEST * exp((bin + 0.5) * STEP)
        return max(self._least, min(self.worst, middle))


class Exchange(Protocol):
    """What the hardware tells of the timing of its last exchange."""

    @property
    def hops(self) -> tuple[float, float]:
        """Request to first byte, first to last byte, s; NaN: nobody answered."""

    @property
    def trips(self) -> Sequence[float]:
        """Request to last byte of each bus, s; NaN: nobody on it answered."""


class Health:
    """Timing of all buses and of the way of a reading."""

    def __init__(self, buses: int, threshold: float = LATENCY) -> None:
        self.total = Window(threshold)  # state age + bus round trip, at the start of each tick
        self.buses = tuple(Window(threshold) for _ in range(buses))
        self.hops: Mapping[str, Window] = {name: Window(threshold) for name in HOPS}
        self._time, self._trip = -inf, nan  # s, of the last exchange in which anybody answered
        self._loud, self._high_at = False, -inf

    def update(
        self, measured: JointState, exchange: Exchange, now: float, *, live: bool
    ) -> tuple[Finding, ...]:
        """After each exchange; `now` is the tick's start, `live`: a bus is open. What is to be told."""
        if not live:
            self._time, self._trip, self._loud = -inf, nan, False
            return ()
        found: tuple[Finding, ...] = ()
        if isfinite(self._time):
            latency = self.latency(now)
            self.total.add(latency, now)
            found = self._warning(latency, now)
        for window, trip in zip(self.buses, exchange.trips, strict=True):
            window.add(trip, now)
        for name, duration in zip(HOPS, exchange.hops, strict=False):
            self.hop(name, duration, now)
        if some(measured.heard):
            self._time, self._trip = measured.time, measured.round_trip
        return found

    def hop(self, name: str, duration: float, now: float) -> None:
        """One hop of a reading took `duration` s. Raises KeyError for a name that is not in HOPS."""
        self.hops[name].add(duration, now)

    def latency(self, now: float) -> float:
        """Age of the newest state + its round trip, s; NaN before the first one."""
        return now - self._time + self._trip

    def latency_p95(self, now: float) -> float:
        """95 % of the latencies of the last 0.5 s are at most this; NaN unknown."""
        return self.total.p95(now)

    def connected(self, now: float) -> bool:
        """Somebody answered within the last 2 s."""
        return now - self._time <= SILENT

    def _warning(self, latency: float, now: float) -> tuple[Finding, ...]:
        """LATENCY_WARN once when it rises above the threshold, again after it was calm for a while."""
        bound = self.total.threshold
        if not latency <= bound:
            was, self._loud, self._high_at = self._loud, True, now
            return () if was else (Finding(Code.LATENCY_WARN, value=latency, bound=bound, message="s"),)
        if not latency <= CALM * bound:
            self._high_at = now
        elif now - self._high_at > CALM_FOR:
            self._loud = False
        return ()
