"""State of one picture as a value, and its collector from a daemon's messages.

Independent of terminals and clocks: `now` is an argument, s, monotonic of this machine.
"""

import threading
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

Answer = Mapping[str, Any]
KEPT = 20  # refusals, events and episodes that are remembered
RATED = 1.0  # s over which rates are counted


@dataclass(frozen=True, slots=True)
class DashboardNotice:
    """One event or refusal. `level`: "refused", or that of the event."""

    at: float  # s, monotonic, when it arrived here
    level: str
    text: str


@dataclass(frozen=True, slots=True)
class MarkedEpisode:
    """A marked stretch of time; `end` None: it goes on."""

    task: str
    begin: float  # s, monotonic
    end: float | None = None
    success: bool | None = None


@dataclass(frozen=True, slots=True)
class DisplayThresholds:
    """From where on a joint's numbers are worth a look. NaN compares as never."""

    lower: float  # rad
    upper: float
    warm: float  # °C, warning
    hot: float  # °C, settles
    low: float  # V, warning
    flat: float  # V, settles


@dataclass(frozen=True, slots=True)
class DashboardState:
    """Everything a picture is made of; pieces are as the interface spells them (`io.twind.Control`)."""

    now: float  # s, monotonic
    status: Answer | None = None
    joints: Sequence[Answer] = ()
    imu: Answer | None = None  # None: none, or no reading yet
    bounds: Mapping[str, DisplayThresholds] = field(default_factory=dict)
    hops: Sequence[Answer] = ()
    lateness: Sequence[Answer] = ()  # Bucket of the whole run
    rates: Mapping[str, float] = field(default_factory=dict)  # exchanges a second, by bus
    refusals: Sequence[DashboardNotice] = ()  # the newest first
    events: Sequence[DashboardNotice] = ()
    episodes: Sequence[MarkedEpisode] = ()
    lost: int = 0  # news that the daemon had to drop because this reader was slow
    news_at: float | None = None  # s, when the last news came
    patience: float = 1.5  # s without news that are no trouble
    gone: str = ""  # why there is no daemon
    gone_since: float = 0.0  # s


class MonitorCollector:
    """Collector of a daemon's messages. `view` may be called in another thread than the other methods."""

    def __init__(self, patience: float = 1.5) -> None:
        self._patience = patience
        self._lock = threading.Lock()
        self._now: dict[str, Any] = {}  # fields of the next view
        self._refusals: deque[DashboardNotice] = deque(maxlen=KEPT)
        self._events: deque[DashboardNotice] = deque(maxlen=KEPT)
        self._episodes: deque[MarkedEpisode] = deque(maxlen=KEPT)
        self._counted: dict[str, tuple[float, int]] = {}  # bus: since when, exchanges then
        self._rates: dict[str, float] = {}
        self._lost = 0
        self.count = 0  # news of joints and changes of the connection so far

    def robot(self, description: Answer) -> None:
        """The robot file as checked, for the bounds of its joints."""
        with self._lock:
            self._now["bounds"] = {joint["name"]: _bounds(joint) for joint in description.get("joints", ())}

    def take(self, news: Answer, now: float) -> None:
        """Process one message of `Monitor`."""
        with self._lock:
            self._now |= {"news_at": now, "gone": ""}
            self._lost += news.get("dropped") or 0
            topic = news["topic"]
            if topic == "state":
                self._now |= {"joints": news["joints"], "imu": news.get("imu")}
                self.count += 1
            elif topic == "status":
                self._status(news["status"], now)
            elif topic == "latency":
                self._now["hops"] = news["latency"]
            elif topic == "verdicts":
                self._verdict(news["verdict"], now)
            elif topic == "events":
                self._event(news["event"], now)

    def record_disconnect(self, why: str, now: float) -> None:
        """Record that the daemon went away or cannot be reached; the first reason stays."""
        with self._lock:
            if not self._now.get("gone"):
                self._now |= {"gone": why, "gone_since": now}
                self._end_episode(now)
                self._counted.clear()
                self.count += 1

    @property
    def is_complete(self) -> bool:
        """True once there is something to show: a status and joints."""
        return "status" in self._now and "joints" in self._now

    def view(self, now: float) -> DashboardState:
        """Return all that is known at `now` (s, monotonic) as a `DashboardState`."""
        with self._lock:
            return DashboardState(
                now=now,
                rates=dict(self._rates),
                refusals=tuple(reversed(self._refusals)),
                events=tuple(reversed(self._events)),
                episodes=tuple(reversed(self._episodes)),
                lost=self._lost,
                patience=self._patience,
                **self._now,
            )

    def _status(self, status: Answer, now: float) -> None:
        self._now["status"] = status
        if lateness := status["loop"].get("lateness"):  # once a second, null between
            self._now["lateness"] = lateness
        for bus in status["buses"]:
            name = bus["name"]
            exchanges = bus["exchanges"]
            since, was = self._counted.setdefault(name, (now, exchanges))
            if now - since >= RATED:
                self._rates[name] = max(0, exchanges - was) / (now - since)
                self._counted[name] = now, exchanges

    def _verdict(self, verdict: Answer, now: float) -> None:
        if refusals := verdict["refusals"]:
            more = f" (and {len(refusals) - 1} more)" if len(refusals) > 1 else ""
            self._refusals.append(DashboardNotice(now, "refused", _reason(refusals[0]) + more))

    def _end_episode(self, now: float, success: bool | None = None) -> None:
        """End the running episode, if there is one.

        Its end mark, the begin mark of the next episode, or the loss of its daemon ends it.
        """
        if self._episodes and self._episodes[-1].end is None:
            last = self._episodes.pop()
            self._episodes.append(MarkedEpisode(last.task, last.begin, now, success))

    def _event(self, event: Answer, now: float) -> None:
        marked = event.get("annotation")
        if marked and marked["kind"] in ("begin", "end"):
            self._end_episode(now, marked.get("success") if marked["kind"] == "end" else None)
        if marked and marked["kind"] == "begin":
            self._episodes.append(MarkedEpisode(marked.get("task") or "episode", now))
        first = [_reason(finding) for finding in event["findings"][:1]]
        text = "; ".join(part for part in (event["message"], *first) if part)
        self._events.append(DashboardNotice(now, event["level"], f"{event['code']}: {text}"))


def followed(joint: Answer, mode: str) -> float | None:
    """Position (rad) that goals move: the joint's in mode live, else its simulation's."""
    place: float | None = joint.get("position" if mode in ("live", "") else "simulated")
    return place


def _reason(finding: Answer) -> str:
    return f"{finding['code']}: {finding['message']}"


def _bounds(joint: Answer) -> DisplayThresholds:
    """Read the display thresholds of one joint of a robot file; a missing threshold is never reached."""
    kind = joint.get("type") or {}
    heat = kind.get("heat") or {}
    supply = kind.get("supply") or {}
    return DisplayThresholds(
        lower=_nan_if_null(joint.get("lower")),
        upper=_nan_if_null(joint.get("upper")),
        warm=_nan_if_null(heat.get("warn")),
        hot=_nan_if_null(heat.get("settle")),
        low=_nan_if_null(supply.get("warn")),
        flat=_nan_if_null(supply.get("settle")),
    )


def _nan_if_null(value: float | None) -> float:
    return float("nan") if value is None else value
