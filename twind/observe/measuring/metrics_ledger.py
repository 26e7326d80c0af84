"""Newest values of the daemon and counters of its messages, for `twindctl metrics`. Pure: no socket, no text.

Times of the daemon and of this process are one machine's monotonic clock.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import inf, nan
from typing import Any

from twind.robot.finding import ReasonCode

Fields = Mapping[str, Any]  # as the interface spells them
Buckets = Sequence[Fields]

TOPICS = ("status", "state", "latency", "events", "verdicts")
STALE = 3.0  # s without news: the daemon counts as gone
SAME_RUN = 1.0  # s by which two reckonings of one beginning may differ: a figure is up to 0.1 s old


@dataclass(frozen=True, slots=True)
class MetricCounters:
    """Counters of the messages that this process received. They begin with the process, and outlive the
    daemon."""

    since: float  # s, wall clock
    refusals: Mapping[str, int] = field(default_factory=Counter)  # by code: verdicts that had it
    verdicts: Mapping[str, int] = field(default_factory=Counter)  # by "accepted", "refused"
    events: Mapping[str, int] = field(default_factory=Counter)  # by code
    lost: int = 0  # messages that the daemon could not send us in time


@dataclass(frozen=True, slots=True)
class DaemonMetrics:
    """The last word of a daemon that is there."""

    status: Fields  # `Status`
    joints: Sequence[Fields]  # `[]Joint`
    latencies: Mapping[str, Fields]  # hop -> `Latency`, with the last histogram
    lateness: Buckets | None  # of the loop, the last that came
    skew_ms: float | None
    began: float  # s, wall clock, when the daemon began to count
    age: float  # s, of the last message
    counted: MetricCounters


class MetricsLedger:
    """Takes messages of `Monitor`, gives news while they are fresh. Not for several threads."""

    def __init__(self, wall: float) -> None:
        """`wall`: the time of the beginning, s since 1970."""
        self._since = wall
        # From 0 on: to Prometheus a series that begins with 1 has not increased.
        self._refusals = Counter({str(code): 0 for code in ReasonCode})
        self._verdicts = Counter({"accepted": 0, "refused": 0})
        self._events = Counter({str(code): 0 for code in ReasonCode})
        self._lost = 0
        # of the run that is reported
        self._began = -inf
        self._began_wall = nan
        self.forget()

    def forget(self) -> None:
        """Drop the values of a daemon that is gone; the counters of this process stay."""
        self._status: Fields | None = None
        self._joints: Sequence[Fields] | None = None
        self._latencies: dict[str, Fields] = {}
        self._lateness: Buckets | None = None
        self._skew: float | None = None
        self._heard = -inf

    def take(self, message: Fields, now: float, wall: float) -> None:
        """Process one message; `now` in s of the monotonic clock, `wall` in s of the wall clock."""
        self._lost += message.get("dropped", 0)
        topic = message["topic"]
        if topic == "verdicts":
            self._verdict(message["verdict"])
        elif topic == "events":
            self._events[message["event"]["code"]] += 1
        else:
            if topic == "status":
                self._take_status(message["status"], message["time"], wall - now)
            elif topic == "state":
                self._joints = message["joints"]
                self._skew = message.get("skew_ms")
            else:
                self._take_latencies(message["latency"])
            self._heard = now  # last: an unreadable message is no news

    def news(self, now: float) -> DaemonMetrics | None:
        """Return the known metrics; None: the daemon is gone, hangs, or has not sent enough yet. `now` in s,
        monotonic."""
        age = now - self._heard
        if not age <= STALE or self._status is None or self._joints is None:
            return None
        counted = MetricCounters(
            self._since, dict(self._refusals), dict(self._verdicts), dict(self._events), self._lost
        )
        return DaemonMetrics(
            self._status,
            self._joints,
            self._latencies,
            self._lateness,
            self._skew,
            self._began_wall,
            max(0.0, age),
            counted,
        )

    @property
    def is_complete(self) -> bool:
        """True once each periodic message has arrived at least once, including all histograms."""
        told = [each.get("histogram") for each in self._latencies.values()]
        known = self._status is not None and self._joints is not None and self._lateness is not None
        return known and bool(told) and None not in told

    def _verdict(self, verdict: Fields) -> None:
        codes = {finding["code"] for finding in verdict["refusals"]}
        self._refusals.update(codes)
        self._verdicts["refused" if codes else "accepted"] += 1

    def _take_status(self, status: Fields, time: float, to_wall: float) -> None:
        loop = status["loop"]
        # A tick or a missed one for every period of the run, so this is when it began.
        began = time - (loop["ticks"] + loop["missed"]) / loop["rate_hz"]
        if abs(began - self._began) > SAME_RUN:
            self._began = began
            self._began_wall = began + to_wall
            self._latencies = {}
            self._lateness = None
        self._status = status
        self._lateness = loop.get("lateness") or self._lateness

    def _take_latencies(self, latencies: Sequence[Fields]) -> None:
        """A histogram comes about once a second; between two the last one holds."""
        now: dict[str, Fields] = {}
        for each in latencies:
            told = each.get("histogram") or self._latencies.get(each["hop"], {}).get("histogram")
            now[each["hop"]] = {**each, "histogram": told}
        self._latencies = now
