"""Latencies of a reading and of a command, hop by hop, and the time since the last reply. Times are s."""

from collections.abc import Mapping, Sequence
from math import inf, isfinite, isnan, nan
from typing import Protocol

from twind.robot.arrays import some
from twind.robot.joint_state import JointState
from twind.safety.latency_alarm import LatencyAlarm, LatencyAlert
from twind.telemetry.rolling_stats import RecentValues, RollingStats

# hops of a reading: sent, first look at the reply, last byte, state, twin
READING = ("request", "reply", "state", "twin")
# hops of a command; the last is the whole but the moving
COMMAND = ("received", "gated", "written", "moved", "command")
LATENCY = 0.05  # s, a warning above it
SILENT = 2.0  # s without a reply: disconnected


class LastExchangeTimes(Protocol):
    """Timing of the last exchange, as the hardware layer reports it."""

    @property
    def hops(self) -> tuple[float, float]:
        """Times from request to first look at the reply, and to its last byte, s; NaN: no device replied."""

    @property
    def trips(self) -> Sequence[float]:
        """Time from request to last byte of each bus, s; NaN: no device on it replied."""


class TimingMonitor:
    """Timing of all buses, of a reading's hops and of a command's hops."""

    def __init__(self, buses: int, threshold: float = LATENCY) -> None:
        self.total = RollingStats(threshold)  # state age + bus round trip, at the start of each tick
        self.buses = tuple(RollingStats(threshold) for _ in range(buses))
        self.hops: Mapping[str, RollingStats] = {
            name: RollingStats(threshold) for name in (*READING, *COMMAND)
        }
        self.hops["moved"].threshold = inf  # a slow move against friction is no latency of the daemon
        # s, of the last exchange with a reply
        self._time = -inf
        self._trip = nan
        self._recent = RecentValues()  # of `total`
        self._alarms = {name: LatencyAlarm(name) for name in ("total", *self.hops)}
        self._alerts: list[LatencyAlert] = []

    def warn_above(self, threshold: float) -> None:
        """Set the threshold, s, of all windows except "moved": a motor takes its time to move."""
        hops = [window for name, window in self.hops.items() if name != "moved"]
        for window in (self.total, *self.buses, *hops):
            window.threshold = threshold

    def update(self, measured: JointState, exchange: LastExchangeTimes, now: float, *, live: bool) -> None:
        """Process an exchange; `now` is the tick's start (s), `live`: a bus is open."""
        if not live:
            self._time = -inf
            self._trip = nan
            for name in ("total", *READING):
                self._queue_alert(self._alarms[name].drop())
            return
        if isfinite(self._time):
            latency = self.latency(now)
            self.total.add(latency, now)
            self._recent.add(latency, now)
            late = inf if isnan(latency) else latency
            self._queue_alert(self._alarms["total"].judge(late, self.total.threshold, now))
        for window, trip in zip(self.buses, exchange.trips, strict=True):
            window.add(trip, now)
        for name, duration in zip(READING, exchange.hops, strict=False):
            self.hop(name, duration, now)
        if some(measured.heard):
            self._time = measured.time
            self._trip = measured.round_trip

    def hop(self, name: str, duration: float, now: float, bound: float | None = None) -> None:
        """Record that a hop took `duration` s; more than `bound` is too long (None: the threshold).

        With bound inf it is a figure alone: it causes no alert. Raises KeyError for an unknown hop.
        """
        window = self.hops[name]
        bound = window.threshold if bound is None else bound
        window.add(duration, now, bound)
        if bound < inf and not (0.0 <= duration <= bound and self._alarms[name].is_off):
            self._queue_alert(self._alarms[name].judge(duration, bound, now))

    def alerts(self) -> list[LatencyAlert]:
        """Return the latency alerts raised since the last call."""
        alerts = self._alerts
        self._alerts = []
        return alerts

    def latency(self, now: float) -> float:
        """Return the age of the newest state plus its round trip, s; NaN before the first one."""
        return now - self._time + self._trip

    def latency_p95(self, now: float) -> float:
        """Return the latency that 95 % of the last 0.5 s do not exceed; NaN unknown."""
        return self._recent.p95(now)

    def connected(self, now: float) -> bool:
        """Check that a device replied within the last 2 s."""
        return now - self._time <= SILENT

    def _queue_alert(self, alert: LatencyAlert | None) -> None:
        if alert is not None:
            self._alerts.append(alert)
