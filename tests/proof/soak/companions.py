"""Processes that a user runs beside a daemon: recorder, viewer with a page, monitor, metrics, program."""

from __future__ import annotations

import http.client
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Collection, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import msgspec
from mcap.reader import make_reader

ROOT = Path(__file__).resolve().parents[3]
SCRAPE = 5.0  # s between two readings of the metrics
# What viser's page reports first: until then the viewer draws nothing for it.
CAMERA = {
    "type": "ViewerCameraMessage",
    **{"wxyz": (1.0, 0.0, 0.0, 0.0), "position": (2.0, 0.0, 1.0), "look_at": (0.0, 0.0, 0.5)},
    **{"up_direction": (0.0, 0.0, 1.0), "fov": 1.0, "near": 0.1, "far": 100.0},
    **{"image_height": 600, "image_width": 800},
}
END = 120.0  # s that a process may take to end


class Companion:
    """One process. `wrong`: how it ended, if not well."""

    def __init__(self, name: str, folder: Path, *words: str, ends: Collection[int] = (0,)) -> None:
        self.name = name
        self.ends = ends
        self.log = folder / f"{name}.log"
        with self.log.open("wb") as log:
            self.process = subprocess.Popen(
                [sys.executable, *words],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE if name == "viewer" else subprocess.DEVNULL,
                stderr=log,
                cwd=ROOT,
            )

    @property
    def pid(self) -> int:
        return self.process.pid

    def wrong(self) -> list[str]:
        """Ended by itself, or complained by a traceback."""
        found = []
        if (code := self.process.poll()) is not None:
            found.append(f"{self.name} ended by itself with {code}: {self._complaints()}")
        elif b"Traceback" in self.log.read_bytes():
            found.append(f"{self.name}: {self._complaints()}")
        return found

    def end(self) -> list[str]:
        """Asked to end; what is wrong with how it did."""
        found = self.wrong()
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
            try:
                if (code := self.process.wait(END)) not in self.ends:
                    found.append(f"{self.name} ended with {code}: {self._complaints()}")
            except subprocess.TimeoutExpired:
                found.append(f"{self.name} did not end within {END:.0f} s")
        return found

    def kill(self) -> None:
        """At once, where it has not ended."""
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait(10)
        if self.process.stdout is not None:
            self.process.stdout.close()

    def _complaints(self) -> str:
        return self.log.read_text(errors="replace")[-600:]


class Page(threading.Thread):
    """A browser's connection to the viewer, which reads all that comes. `bytes`: so far."""

    def __init__(self, url: str) -> None:
        super().__init__(daemon=True)
        self._parts = urlsplit(url)
        self._over = threading.Event()
        self.bytes = 0
        self.opened = 0
        self.start()

    def run(self) -> None:
        import viser
        from websockets.exceptions import WebSocketException
        from websockets.sync.client import connect

        while not self._over.is_set():
            with (
                suppress(WebSocketException, OSError),
                connect(
                    f"ws://{self._parts.netloc}{self._parts.path}",
                    origin=f"http://{self._parts.netloc}",  # type: ignore[arg-type]
                    subprotocols=[f"viser-v{viser.__version__}"],  # type: ignore[list-item]
                    max_size=None,
                    ping_timeout=None,
                ) as line,
            ):
                self.opened += 1
                line.send(msgspec.msgpack.encode(CAMERA))
                while not self._over.is_set():
                    with suppress(TimeoutError):
                        self.bytes += len(line.recv(timeout=1.0))
            self._over.wait(0.5)

    def end(self) -> None:
        self._over.set()
        self.join(10.0)


class Companions:
    """All of them beside the daemon with its sockets in `sockets`; they write into `folder`."""

    def __init__(self, sockets: Path, folder: Path) -> None:
        verb = ("-m", "twind.ctl.ctl_main", "--socket", str(sockets))
        self.recordings = folder / "recordings"
        self.metrics = folder / "metrics.sock"
        bounds = ("--max-size", "2M", "--keep", "8M", "--free", "1M")
        left = (0, -signal.SIGTERM, 128 + signal.SIGTERM)
        self.each = [
            Companion("recorder", folder, *verb, "record", "--out", str(self.recordings), *bounds),
            Companion("viewer", folder, *verb, "--json", "view"),
            Companion("monitor", folder, *verb, "--json", "monitor", "--rate", "10", ends=left),
            Companion("metrics", folder, *verb, "metrics", "--unix", str(self.metrics)),
            Companion("program", folder, "-m", "tests.proof.soak.state_reader", str(sockets)),
        ]
        viewer = self.each[1].process
        assert viewer.stdout is not None
        line = viewer.stdout.readline()
        if not line:
            raise AssertionError(f"no viewer: {self.each[1].log.read_text()[-600:]}")
        self.page = Page(json.loads(line)["url"])
        self.scraped = 0
        self._scrape = 0.0

    def pids(self) -> Iterator[tuple[str, int]]:
        """Names and process ids of the running ones."""
        return ((each.name, each.pid) for each in self.each if each.process.poll() is None)

    def look(self) -> list[str]:
        """Read the metrics now and then; what is wrong."""
        found = [what for each in self.each for what in each.wrong()]
        if time.monotonic() - self._scrape > SCRAPE and self.metrics.exists():
            self._scrape = time.monotonic()
            status, text = scrape(self.metrics)
            if status != 200 or b"twind_up" not in text:
                found.append(f"metrics answered {status}: {text[:200]!r}")
            self.scraped += 1
        return found

    def end(self) -> list[str]:
        """All are asked to end; what is wrong with them, the page and the recordings."""
        self.page.end()
        found = [what for each in self.each for what in each.end()]
        if not self.page.bytes:
            found.append("nothing came from the viewer")
        return found

    def figures(self) -> dict[str, Any]:
        """Counts of their work, after their end. Raises the error of a broken recording."""
        files = sorted(self.recordings.rglob("*.mcap"))
        counts = [messages(each) for each in files]
        return {
            "recordings": len(files),
            "recorded_messages": sum(counts),
            "recorded_mb": round(sum(each.stat().st_size for each in files) / 1e6, 2),
            "page_mb": round(self.page.bytes / 1e6, 2),
            "pages": self.page.opened,
            "scraped": self.scraped,
        }

    def close(self) -> None:
        """End at once what has not ended."""
        self.page.end()
        for each in self.each:
            each.kill()


def messages(recording: Path) -> int:
    """Messages of a recording, all read. Raises the reader's errors."""
    with recording.open("rb") as stream:
        return sum(1 for _ in make_reader(stream).iter_messages())


def scrape(place: Path) -> tuple[int, bytes]:
    """Status and text of an answer over a Unix socket; 0: there was none."""
    connection = http.client.HTTPConnection("localhost", timeout=20.0)
    connection.sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    connection.sock.settimeout(20.0)
    try:
        connection.sock.connect(os.fspath(place))
        connection.request("GET", "/metrics")
        answer = connection.getresponse()
        return answer.status, answer.read()
    except OSError as error:
        return 0, repr(error).encode()
    finally:
        connection.close()
