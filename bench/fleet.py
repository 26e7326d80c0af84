"""`fleet.*`: a thousand robots through one Zenoh router: messages, CPU of each part, loss, time on the way.

Each robot has a session of its own, as each machine has; what it sends is a message of a real daemon whose
joints all move. Robots, router and listener share this machine's cores: what saturates first is the machine.
"""

import json
import socket
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any

from bench.daemon import live, scratch
from bench.harness import (
    ROUNDS,
    FigureSpec,
    MeasuredFigure,
    Measurement,
    MeasurementUnavailable,
    cpu_of,
    spread,
)
from bench.motion import kept_moving
from twind.bridge.zenoh.zenoh_keys import ROOT, robot_key

# robots, and the processes that they are in
COUNT = 1000
CROWDS = 2
# s of a window, and until what is on its way has come
SPAN = 2.0
SETTLE = 0.5
RATE = 10.0  # Hz: what a fleet view asks for
STEPS = (1.0, 2.0, 5.0, 10.0, 15.0, 20.0, 30.0)  # Hz of every robot, until more than LOST is lost
LOST = 0.001
HEARD = COUNT // 100  # robots that somebody looks at, where not all are
PATIENCE = 60.0  # s until all robots are there again
ALL = f"{ROOT}/*/state/10"


class FleetProcess:
    """A process of `bench/fleet_parts.py`."""

    def __init__(self, what: str, *words: object) -> None:
        command = [sys.executable, "-m", "bench.fleet_parts", what, *map(str, words)]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
        self.what = what
        self.pid = self._process.pid

    def ask(self, **asked: Any) -> Mapping[str, Any]:
        """And its answer. Raises CannotTake."""
        self.begin(**asked)
        return self.answer()

    def begin(self, **asked: Any) -> None:
        """Ask; the answer is to be fetched."""
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(asked) + "\n")
        self._process.stdin.flush()

    def answer(self) -> Mapping[str, Any]:
        """The next one; the first says that it is ready. Raises CannotTake."""
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise MeasurementUnavailable(f"{self.what} ended")
        found: Mapping[str, Any] = json.loads(line)
        return found

    def memory(self) -> int:
        """kB that it holds."""
        status = Path(f"/proc/{self.pid}/status").read_text()
        return int(next(line.split()[1] for line in status.splitlines() if line.startswith("VmRSS")))

    def close(self) -> None:
        """At once: it keeps nothing."""
        self._process.kill()
        self._process.communicate()


@dataclass(frozen=True, slots=True)
class FleetMeasurement:
    """One stretch. CPU in s, `p50` and `p99` in s from the robot to the listener."""

    sent: int
    got: int
    late: float  # s by which the robots fell behind
    cpu: Mapping[str, float]  # by what they are
    p50: float  # infinite where nothing came
    p99: float

    @property
    def lost(self) -> float:
        """Share of what should have come, were all listened to."""
        return 1.0 - self.got / self.sent

    def each(self, what: str) -> float:
        """µs of CPU for a message that was sent."""
        return self.cpu[what] / self.sent * 1e6


class BenchFleet:
    """Robots, `routers` that share them out, and a listener at each."""

    def __init__(self, stack: ExitStack, payload: Path, routers: int = 1) -> None:
        self.endpoints = [f"tcp/127.0.0.1:{_free_port()}" for _ in range(routers)]
        self._stack = stack
        self.routers = [self._part("router", each) for each in self.endpoints]
        self._ready(self.routers)
        places = range(0, COUNT, COUNT // CROWDS)
        words = [(place, COUNT // CROWDS, payload) for place in places]
        self.crowds = [
            self._part("robots", self.endpoints[i % routers], *each) for i, each in enumerate(words)
        ]
        self.listeners = [self._part("listener", each) for each in self.endpoints]
        self._ready([*self.crowds, *self.listeners])
        for crowd in self.crowds:
            crowd.ask(key="10")

    def _part(self, *words: object) -> FleetProcess:
        part = FleetProcess(*map(str, words))
        self._stack.callback(part.close)
        return part

    @staticmethod
    def _ready(parts: Sequence[FleetProcess]) -> None:
        for part in parts:
            part.answer()

    def restart(self) -> float:
        """Kill the first router and start it anew: s until all its robots are there again."""
        self.routers[0].close()
        since = time.monotonic()
        self.routers[0] = self._part("router", self.endpoints[0])
        self._ready(self.routers[:1])
        while time.monotonic() - since < PATIENCE:
            if self.listeners[0].ask(alive=1)["alive"] >= COUNT // len(self.routers):
                return time.monotonic() - since
            time.sleep(0.1)
        raise MeasurementUnavailable(f"not all robots were back within {PATIENCE:g} s")

    def window(self, rate: float, keys: Sequence[str]) -> FleetMeasurement:
        """All robots send at `rate` Hz; each listener hears `keys`."""
        parts = [*self.routers, *self.crowds, *self.listeners]
        for listener in self.listeners:
            listener.ask(listen=list(keys))
        time.sleep(SETTLE)
        before = [cpu_of(part.pid) for part in parts]
        for listener in self.listeners:
            listener.ask()
        start = time.monotonic() + 0.1
        for crowd in self.crowds:
            crowd.begin(rate=rate, seconds=SPAN, start=start)
        sent = [crowd.answer() for crowd in self.crowds]
        time.sleep(SETTLE)
        heard = [listener.ask() for listener in self.listeners]
        cpu = dict.fromkeys(("router", "robots", "listener"), 0.0)
        for part, was in zip(parts, before, strict=True):
            cpu[part.what] += cpu_of(part.pid) - was
        p50, p99 = (max(each["way"].get(rank, inf) for each in heard) for rank in ("0.5", "0.99"))
        late = max(each["late"] for each in sent)
        return FleetMeasurement(
            sum(each["sent"] for each in sent), sum(each["count"] for each in heard), late, cpu, p50, p99
        )


def _free_port() -> int:
    with socket.socket() as sock:
        sock.bind(("127.0.0.1", 0))
        port: int = sock.getsockname()[1]
    return port


@contextmanager
def payload() -> Iterator[tuple[Path, int]]:
    """A file with a message of topic `state` of a real daemon whose 24 joints all move, and its bytes."""
    with scratch() as folder:
        file = folder / "state.json"
        with live(folder) as daemon, kept_moving(daemon), daemon.client() as client:
            bursts = client.bursts("Monitor", topics=["state"], rate=RATE)
            message = [next(bursts)[-1] for _ in range(20)][-1]
        file.write_bytes(message)
        yield file, len(message)


def take() -> Mapping[str, MeasuredFigure]:
    """All figures, from one fleet on one router, then one on two."""
    with payload() as (file, size):
        with ExitStack() as stack:
            fleet = BenchFleet(stack, file)
            memory = fleet.routers[0].memory() / COUNT
            some = [
                robot_key(f"robot-{place:04}", "state", "10") for place in range(0, COUNT, COUNT // HEARD)
            ]
            ways: Mapping[str, Sequence[str]] = {"all": [ALL], "some": some, "none": []}
            windows: dict[str, list[FleetMeasurement]] = {way: [] for way in ways}
            for _ in range(ROUNDS):
                for way, keys in ways.items():
                    windows[way].append(fleet.window(RATE, keys))
            climbed = _climb(fleet)
            back = fleet.restart()
        with ExitStack() as stack:
            twice = _climb(BenchFleet(stack, file, 2))
    return _figures(windows, climbed, twice, size) | {
        "fleet.router_memory": MeasuredFigure(
            memory, "kB of the router's memory for each robot, nobody sending"
        ),
        "fleet.back": MeasuredFigure(
            back, "from the start of a router that was killed; a session tries each 1 to 4 s"
        ),
    }


def _climb(fleet: BenchFleet) -> list[FleetMeasurement]:
    """Windows at rising rates, up to the first that loses more than LOST, or whose robots fall behind."""
    climbed: list[FleetMeasurement] = []
    for rate in STEPS:
        climbed.append(fleet.window(rate, [ALL]))
        if climbed[-1].lost > LOST or climbed[-1].late > SPAN / 10:
            break
    return climbed


def _carried(climbed: Sequence[FleetMeasurement]) -> float:
    """Messages/s of the last step that held."""
    held = [window.got / SPAN for window in climbed if window.lost <= LOST and window.late <= SPAN / 10]
    return max(held, default=0.0)


def _format_climb(climbed: Sequence[FleetMeasurement]) -> str:
    steps = (
        f"{w.sent / SPAN:.0f}/s: lost {w.lost:.2%}, p99 {w.p99 * 1e3:.0f} ms, cores of router"
        f" {w.cpu['router'] / SPAN:.2f}, robots {w.cpu['robots'] / SPAN:.2f},"
        f" listener {w.cpu['listener'] / SPAN:.2f}"
        for w in climbed
    )
    return "; ".join(steps)


def _figures(
    windows: Mapping[str, Sequence[FleetMeasurement]],
    climbed: Sequence[FleetMeasurement],
    twice: Sequence[FleetMeasurement],
    size: int,
) -> dict[str, MeasuredFigure]:
    def middle(way: str, value: Callable[[FleetMeasurement], float]) -> float:
        return statistics.median(value(window) for window in windows[way])

    heard = windows["all"]
    each = {what: statistics.median(w.each(what) for w in heard) for what in heard[0].cpu}
    over = spread([window.each("router") for window in heard], "µs")
    one = _carried(climbed)
    two = _carried(twice)
    at = f"{COUNT} robots at {RATE:g} Hz, all heard by one"
    return {
        "fleet.carried": MeasuredFigure(one, f"{size} B each, up to 0.1 % lost. {_format_climb(climbed)}"),
        "fleet.carried_by_two": MeasuredFigure(
            two, f"two routers, half the robots each. {_format_climb(twice)}"
        ),
        "fleet.router_cpu": MeasuredFigure(
            each["router"], f"{at}; {over}; robots {each['robots']:.1f}, listener {each['listener']:.1f}"
        ),
        "fleet.router_cpu_some": MeasuredFigure(
            middle("some", lambda w: w.each("router")), f"the same offered, {HEARD} robots heard"
        ),
        "fleet.router_cpu_none": MeasuredFigure(
            middle("none", lambda w: w.each("router")), "the same offered, nobody hears: nothing is sent"
        ),
        "fleet.lost": MeasuredFigure(
            middle("all", lambda w: w.lost * 100.0), f"{at}; {spread([w.lost * 100.0 for w in heard], '%')}"
        ),
        "fleet.way_p99": MeasuredFigure(
            middle("all", lambda w: w.p99 * 1e3),
            f"{at}, from put to callback; p50 {middle('all', lambda w: w.p50 * 1e3):.2f} ms",
        ),
    }


MEASUREMENTS = (
    Measurement(
        {
            "fleet.carried": FigureSpec("1/s"),
            "fleet.carried_by_two": FigureSpec("1/s"),
            "fleet.router_cpu": FigureSpec("µs"),
            "fleet.router_cpu_some": FigureSpec("µs"),
            "fleet.router_cpu_none": FigureSpec("µs"),
            "fleet.lost": FigureSpec("%"),
            "fleet.way_p99": FigureSpec("ms"),
            "fleet.router_memory": FigureSpec("kB"),
            "fleet.back": FigureSpec("s"),
        },
        take,
    ),
)
