"""`observe.*`: what those who look on cost: lateness of ticks beside 0, 1 and 16 subscribers, and CPU."""

import json
import selectors
import socket
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

from bench.daemon import BenchDaemon, live, scratch
from bench.harness import (
    FigureSpec,
    MeasuredFigure,
    Measurement,
    MeasurementUnavailable,
    cpu_of,
    interleaved,
    medians,
    quantile,
    spread,
)
from bench.lateness_log import LatenessLog

# s of each window
ROUNDS = 10
SPAN = 4.0
RATE = 100.0  # Hz of every topic
TOPICS = ("state", "status", "latency")
EACH = 1  # messages a tick at least: of state; status and latency come ten times a second
CROWD = (0, 1, 16)  # subscribers


class SubscriberLoad:
    """So many who watch everything at full rate, in a thread that throws away what they get."""

    def __init__(self, daemon: BenchDaemon, count: int) -> None:
        call = {
            "method": "io.twind.Control.Monitor",
            "parameters": {"topics": TOPICS, "rate": RATE},
            "more": True,
        }
        self._selector = selectors.DefaultSelector()
        self._sockets = []
        for _ in range(count):
            sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
            sock.connect(str(daemon.sockets / "observe.sock"))
            sock.sendall(json.dumps(call).encode() + b"\0")
            self._selector.register(sock, selectors.EVENT_READ)
            self._sockets.append(sock)
        self.messages = 0
        self.bytes = 0
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        buffer = bytearray(1 << 18)
        while not self._ended.is_set():
            for key, _ in self._selector.select(0.1):
                sock = key.fileobj
                assert isinstance(sock, socket.socket)
                count = sock.recv_into(buffer)
                self.messages += buffer.count(b"\0", 0, count)
                self.bytes += count

    def close(self) -> None:
        """Hang up."""
        self._ended.set()
        self._thread.join()
        for sock in self._sockets:
            sock.close()


@dataclass(frozen=True, slots=True)
class ObserverCost:
    """Cost of one window of time for the daemon."""

    late: float  # s, p99 of the ticks' lateness
    loop: float  # % of a core
    front: float
    missed: int


def take() -> Mapping[str, MeasuredFigure]:
    """All windows of one daemon in mode live, its robot not armed."""
    with scratch() as folder:
        record = folder / "lateness"
        with live(folder, command=("-m", "bench.lateness_log", str(record))) as daemon:
            lateness = LatenessLog(record)
            windows = dict[int, list[ObserverCost]]({count: [] for count in CROWD})

            def window(count: int) -> float:
                found = _window(daemon, lateness, count)
                windows[count].append(found)
                return found.late * 1e6

            interleaved(ROUNDS, {str(count): partial(window, count) for count in CROWD})
            with daemon.client() as client:
                policy = client.call("GetStatus")["status"]["loop"]["realtime"]["scheduler"]
    return _figures(windows, policy)


def _window(daemon: BenchDaemon, lateness: LatenessLog, count: int) -> ObserverCost:
    subscribers = SubscriberLoad(daemon, count)
    try:
        time.sleep(0.3)
        with daemon.client() as client:
            missed = client.call("GetStatus")["status"]["loop"]["missed"]
            pids = (daemon.pid, daemon.front)
            since = time.monotonic()
            start = len(lateness)
            told = subscribers.messages
            before = [cpu_of(pid) for pid in pids]
            time.sleep(SPAN)
            span = time.monotonic() - since
            loop, front = ((cpu_of(pid) - was) / span * 100.0 for pid, was in zip(pids, before, strict=True))
            late = lateness.since(start)
            heard = (subscribers.messages - told) / len(late) / max(1, count)
            missed = client.call("GetStatus")["status"]["loop"]["missed"] - missed
    finally:
        subscribers.close()
    if count and heard < 0.95 * EACH:
        raise MeasurementUnavailable(
            f"each of {count} subscribers got {heard:.2f} messages a tick, expected {EACH}"
        )
    return ObserverCost(quantile(late, 0.99), loop, front, missed)


def _figures(windows: Mapping[int, list[ObserverCost]], policy: str) -> dict[str, MeasuredFigure]:
    late = {count: [each.late * 1e6 for each in rows] for count, rows in windows.items()}
    both = {count: [each.loop + each.front for each in rows] for count, rows in windows.items()}
    front = medians({str(count): [each.front for each in rows] for count, rows in windows.items()})
    p99 = medians({str(c): v for c, v in late.items()})
    cpu = medians({str(c): v for c, v in both.items()})
    missed = {count: sum(each.missed for each in rows) for count, rows in windows.items()}
    how = f"live, 24 virtual servos, not armed; {'+'.join(TOPICS)} at {RATE:g} Hz; policy {policy}"
    ticks = round(ROUNDS * SPAN * 100)
    said = ", ".join(f"{count}: {p99[str(count)]:.0f} µs" for count in CROWD)
    added = {count: cpu[str(count)] - cpu["0"] for count in CROWD}
    lost = ", ".join(f"{count}: {missed[count]} of {ticks}" for count in CROWD)
    return {
        "observe.late_16_subscribers": MeasuredFigure(
            p99["16"] / p99["0"],
            f"{how}; p99 beside {said}; {spread(late[0], 'µs')} beside none, {spread(late[16], 'µs')} "
            f"beside 16; with one {p99['1'] / p99['0']:.2f}",
        ),
        "observe.monitor_cpu": MeasuredFigure(
            added[1],
            f"{how}; loop and front together {cpu['0']:.2f} beside none, {cpu['1']:.2f} beside one (front "
            f"{front['0']:.2f} and {front['1']:.2f}), 16 add {added[16]:.2f}; ticks missed beside {lost}",
        ),
    }


MEASUREMENTS = (
    Measurement(
        {
            "observe.late_16_subscribers": FigureSpec("ratio", "≤ 1.5"),
            "observe.monitor_cpu": FigureSpec("% of a core", "< 2"),
        },
        take,
    ),
)
