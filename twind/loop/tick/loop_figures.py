"""Statistics of the loop: ticks, missed ticks, lateness. Published, never asserted."""

from collections import deque
from collections.abc import Mapping

from twind import link
from twind.loop.process.realtime import Granted
from twind.telemetry.rolling_stats import BOUNDS_MS, RollingStats

ON_TIME = 0.002  # s: a tick that begins later than this is late (LOOP_LATE warns from here)


class LoopFigures:
    """Statistics of one loop, updated once per tick."""

    def __init__(self, period: float, realtime: Mapping[str, Granted]) -> None:
        self._period = period
        self._realtime = realtime
        self.ticks = 0
        self.missed = 0
        self.lateness = 0.0  # s, of the tick that runs
        self.missed_in_a_row = 0  # ticks skipped after the last one
        self.failed_in_a_row = 0  # ticks that raised an exception
        self._gap = 0.0  # s, the longest time in which ticks were due and none began
        self._late = RollingStats(threshold=ON_TIME)
        self._punctual: deque[bool] = deque([True] * 100, maxlen=100)

    def tick(self, missed: int) -> None:
        """Count the tick that began `lateness` s after its deadline; `missed` ticks were skipped after it."""
        lateness = self.lateness
        self.missed_in_a_row = missed
        self.ticks += 1
        self.missed += missed
        self._gap = max(self._gap, missed * self._period)
        self._late.add(lateness)
        self._punctual.append(lateness <= ON_TIME)

    def info(self, *, whole: bool = False) -> link.LoopInfo:
        """Return the figures for the interface; p50, p99 and max cover the whole run.

        `whole`: with the histogram.

        Quantiles and histogram cover the ticks that began; the longest wait covers missed ticks too.
        """
        late = self._late
        measured = self.ticks > 0
        return link.LoopInfo(
            rate_hz=1.0 / self._period,
            ticks=self.ticks,
            missed=self.missed,
            on_time=sum(self._punctual) / len(self._punctual),
            late_p50_us=late.p50 * 1e6 if measured else None,
            late_p99_us=late.p99 * 1e6 if measured else None,
            late_max_us=max(late.worst, self._gap) * 1e6 if measured else None,
            realtime={what: got.text for what, got in self._realtime.items()},
            realtime_denied=[what for what, got in self._realtime.items() if not got.granted],
            lateness=buckets(late) if whole else None,
            lateness_sum_ms=late.sum * 1e3 if whole else None,
        )


def buckets(window: RollingStats) -> list[link.Bucket]:
    """Return the whole run of a window as buckets of the interface."""
    bounds = (*BOUNDS_MS, None)
    return [link.Bucket(bound, count) for bound, count in zip(bounds, window.buckets, strict=True)]
