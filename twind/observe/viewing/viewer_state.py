"""State of one robot in the viewer, made of the messages of `Monitor`; filled by one thread, read by another.

No browser, no socket: a recording is shown by the same messages.
"""

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from twind.ctl.dashboard.dashboard_state import followed
from twind.robot.arrays import Floats

WINDOW = 10.0  # s of history that is plotted
KEPT = 3000  # messages of it at most: 300 Hz; also where the time that they tell stands still
TOLD = 5  # last refusals, and last events, that are shown
STALE = 3.0  # periods of the loop after which a joint's reading is called old
LEAST_STALE_MS = 50.0
Message = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class RobotAnnounced:
    """Description of the robot that the following messages belong to: the answer of `GetRobot`."""

    told: Message


@dataclass(frozen=True, slots=True)
class DaemonLost:
    """The daemon is gone, or cannot be reached; the next message shows that it is back."""

    why: str


News = RobotAnnounced | DaemonLost | Message


@dataclass(frozen=True, slots=True)
class JointsMessage:
    """One message of the topic `state`. Arrays are (n,); NaN: not known."""

    time: float  # s, monotonic
    measured: Floats  # rad
    goal: Floats
    simulated: Floats
    followed: Floats  # what the goals move: see `twind.ctl.dashboard.dashboard_state.followed`
    heard: Any  # (n,) bool
    age: Floats  # ms
    faults: tuple[tuple[str, ...], ...]
    external: Floats  # N·m, from outside
    contact: Any  # (n,) bool: the daemon reports CONTACT

    @property
    def error(self) -> Floats:
        """rad, between what was commanded and where that is which follows it."""
        return np.abs(self.goal - self.followed)


def joints_of(message: Message, mode: str) -> JointsMessage:
    """Convert a message of the topic `state`, from a daemon in `mode` (empty: not known yet)."""
    rows: Sequence[Message] = message["joints"]

    def numbers(values: Iterable[float | None]) -> Floats:
        return np.array([np.nan if value is None else value for value in values], np.float64)

    def column(key: str) -> Floats:
        return numbers(row.get(key) for row in rows)

    return JointsMessage(
        time=float(message["time"]),
        measured=column("position"),
        goal=column("goal"),
        simulated=column("simulated"),
        followed=numbers(followed(row, mode) for row in rows),
        heard=np.array([bool(row.get("heard", True)) for row in rows]),
        age=column("age_ms"),
        faults=tuple(tuple(row.get("faults") or ()) for row in rows),
        external=column("external_nm"),
        contact=np.array([bool(row.get("contact")) for row in rows], np.bool_),
    )


@dataclass(frozen=True, slots=True)
class ViewerSnapshot:
    """All that the viewer knows of a robot at one moment."""

    told: Message | None  # the robot
    lost: str | None  # why nothing comes
    joints: JointsMessage | None
    status: Message | None
    latency: Sequence[Message]
    refusals: tuple[Message, ...]  # verdicts with refusals, the newest first
    events: tuple[Message, ...]  # warnings and errors, the newest first
    age: float | None = None  # s since the last joints; None: none yet

    @property
    def mode(self) -> str:
        """Mode that the daemon reports; empty while it is not known."""
        return _mode(self.status)

    @property
    def stale(self) -> Any:
        """Joints (n,) bool that have answered, but whose newest value is old."""
        assert self.joints is not None
        rate = 100.0 if self.status is None else float(self.status["loop"]["rate_hz"])
        old: Any = ~(self.joints.age <= max(LEAST_STALE_MS, STALE * 1e3 / rate))
        return old & self.joints.heard


def _mode(status: Message | None) -> str:
    return "" if status is None else str(status["mode"])


class ViewerState:
    """The latest of everything, and the last seconds of what is plotted."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._told: Message | None = None
        self._lost: str | None = None
        self._forget()

    def _forget(self) -> None:
        self._joints: JointsMessage | None = None
        self._heard = 0.0  # s, when they came
        self._status: Message | None = None
        self._latency: Sequence[Message] = ()
        self._refusals: deque[Message] = deque(maxlen=TOLD)
        self._events: deque[Message] = deque(maxlen=TOLD)
        self._path: deque[JointsMessage] = deque(maxlen=KEPT)
        self._hops: deque[tuple[float, Mapping[str, float]]] = deque(maxlen=KEPT)

    def take(self, news: News) -> None:
        """The next piece."""
        with self._lock:
            if isinstance(news, RobotAnnounced):
                self._forget()
                self._told = news.told
                self._lost = None
            elif isinstance(news, DaemonLost):
                self._lost = news.why
            else:
                self._lost = None
                self._message(news)

    def _message(self, news: Message) -> None:
        match news["topic"]:
            case "state":
                self._joints = joints_of(news, _mode(self._status))
                self._heard = self._clock()
                self._path.append(self._joints)
                while self._joints.time - self._path[0].time > WINDOW or _behind(self._path):
                    self._path.popleft()
            case "status":
                self._status = news["status"]
            case "latency":
                self._latency = news["latency"]
                hops = {hop["hop"]: hop["now_ms"] for hop in self._latency if hop.get("now_ms") is not None}
                self._hops.append((float(news["time"]), hops))
                while self._hops[-1][0] - self._hops[0][0] > WINDOW or self._hops[0][0] > self._hops[-1][0]:
                    self._hops.popleft()
            case "verdicts" if news["verdict"]["refusals"]:
                self._refusals.appendleft(news)
            case "events" if news["event"]["level"] in ("warning", "error"):
                self._events.appendleft(news)

    def now(self) -> ViewerSnapshot:
        """A copy that stays as it is."""
        with self._lock:
            return ViewerSnapshot(
                self._told,
                self._lost,
                self._joints,
                self._status,
                self._latency,
                tuple(self._refusals),
                tuple(self._events),
                None if self._joints is None else self._clock() - self._heard,
            )

    def path(self) -> list[JointsMessage]:
        """The last seconds of the joints, the oldest first."""
        with self._lock:
            return list(self._path)

    def hops(self) -> list[tuple[float, Mapping[str, float]]]:
        """The last seconds of latencies: time in s, and ms by hop."""
        with self._lock:
            return list(self._hops)


def _behind(path: "deque[JointsMessage]") -> bool:
    """Time went back: a recording began anew."""
    return path[0].time > path[-1].time
