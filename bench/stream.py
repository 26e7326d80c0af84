"""`stream.*`: what a streamed sample costs, spool and POST included, and what that does to the loop."""

import json
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

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
SPAN = 5.0
START = 3.0  # s from exec until a streamer does what it will go on doing
RATE = 100.0
WAYS: Mapping[str, tuple[str, ...]] = {"none": (), "streamer": ("--age", "1"), "gzip": ("--gzip",)}
OK = b"HTTP/1.1 200 OK\r\nContent-Length: 0\r\n\r\n"


class HttpSink:
    """An endpoint in a thread of this process that takes whatever comes and answers 200."""

    def __init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self._listener.getsockname()[1]}/ingest"
        self.messages = self.bytes = 0
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                client, _ = self._listener.accept()
                threading.Thread(target=self._serve, args=(client,), daemon=True).start()

    def _serve(self, client: socket.socket) -> None:
        with client, suppress(OSError, ValueError), client.makefile("rb") as file:
            while file.readline():
                length = 0
                while (line := file.readline().strip()) != b"":
                    name, _, value = line.partition(b":")
                    length = int(value) if name.lower() == b"content-length" else length
                file.read(length)
                self.messages = self.messages + 1
                self.bytes = self.bytes + length
                client.sendall(OK)

    def close(self) -> None:
        """Take no more."""
        self._listener.close()


@dataclass(frozen=True, slots=True)
class StreamCost:
    """One stretch of time. `cpu`: s of the streamer; `samples`, `bytes`: that were sent."""

    late: float  # s, p99 of the ticks' lateness
    missed: int
    cpu: float = 0.0
    samples: float = 0.0
    bytes: int = 0
    messages: int = 0


@contextmanager
def streaming(daemon: BenchDaemon, spool: Path, url: str, options: tuple[str, ...]) -> Iterator[int | None]:
    """A `twindctl stream`, and its process id; None where no options are given: nobody streams."""
    if not options:
        yield None
        return
    words = [
        "--json",
        "--socket",
        str(daemon.sockets),
        "stream",
        "--url",
        url,
        "--spool",
        str(spool),
        *options,
    ]
    process = subprocess.Popen([sys.executable, "-m", "twind.ctl.ctl_main", *words], stdout=subprocess.PIPE)
    try:
        yield process.pid
    finally:
        process.terminate()
        told = json.loads(process.communicate()[0])
    if told["failures"] or told["dropped"]:
        raise MeasurementUnavailable(
            f"the streamer had {told['failures']} failures and dropped {told['dropped']}"
        )


def take() -> Mapping[str, MeasuredFigure]:
    """All windows of one daemon in mode live, its robot not armed."""
    windows: dict[str, list[StreamCost]] = {way: [] for way in WAYS}
    sink = HttpSink()
    with scratch() as folder:
        record = folder / "lateness"
        with live(folder, command=("-m", "bench.lateness_log", str(record))) as daemon:
            lateness = LatenessLog(record)

            def window(way: str) -> float:
                with streaming(daemon, folder / f"spool-{way}", sink.url, WAYS[way]) as pid:
                    windows[way].append(_window(daemon, lateness, sink, pid))
                return windows[way][-1].late

            interleaved(ROUNDS, {way: partial(window, way) for way in WAYS})
            with daemon.client() as client:
                policy = client.call("GetStatus")["status"]["loop"]["realtime"]["scheduler"]
    sink.close()
    return _figures(windows, policy)


def _window(daemon: BenchDaemon, lateness: LatenessLog, sink: HttpSink, pid: int | None) -> StreamCost:
    time.sleep(START)
    with daemon.client() as client:
        missed = client.call("GetStatus")["status"]["loop"]["missed"]
        start = len(lateness)
        was = cpu_of(pid) if pid is not None else 0.0
        since = time.monotonic()
        taken = sink.messages
        size = sink.bytes
        time.sleep(SPAN)
        span = time.monotonic() - since
        cpu = cpu_of(pid) - was if pid is not None else 0.0
        late = lateness.since(start)
        missed = client.call("GetStatus")["status"]["loop"]["missed"] - missed
    messages = sink.messages - taken
    if pid is not None and not messages:
        raise MeasurementUnavailable("nothing was sent")
    return StreamCost(quantile(late, 0.99), missed, cpu, span * RATE, sink.bytes - size, messages)


def _figures(windows: Mapping[str, list[StreamCost]], policy: str) -> dict[str, MeasuredFigure]:
    late = {way: [each.late * 1e6 for each in rows] for way, rows in windows.items()}
    cost = {
        way: [each.cpu / each.samples * 1e6 for each in rows]
        for way, rows in windows.items()
        if way != "none"
    }
    p99 = medians(late)
    cpu = medians(cost)
    sent = windows["streamer"]
    size = sum(each.bytes for each in sent) / sum(each.messages for each in sent)
    missed = ", ".join(f"{way} {sum(each.missed for each in rows)}" for way, rows in windows.items())
    how = f"24 virtual servos in live, not armed, {RATE:g} Hz, batches of 32 in {size / 1e3:.1f} kB"
    return {
        "stream.sample_cpu": MeasuredFigure(
            cpu["streamer"],
            f"{how}; the whole process: its JSON in, ours out, synced to the disk, POST on loopback; "
            f"{spread(cost['streamer'], 'µs')}; with --gzip {cpu['gzip']:.0f}",
        ),
        "stream.late_beside": MeasuredFigure(
            p99["streamer"] / p99["none"],
            f"{how}; policy {policy}; p99 beside none {p99['none']:.0f} µs, {spread(late['none'], 'µs')}; "
            f"with it {p99['streamer']:.0f} µs, {spread(late['streamer'], 'µs')}; ticks missed {missed}",
        ),
    }


MEASUREMENTS = (
    Measurement(
        {"stream.sample_cpu": FigureSpec("µs", "≤ 60"), "stream.late_beside": FigureSpec("ratio", "≤ 1.2")},
        take,
    ),
)
