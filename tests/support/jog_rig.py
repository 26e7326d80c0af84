"""A browser page that jogs a simulated robot: held buttons, a line that can be cut, and the commanded position."""

import contextlib
import os
import signal
import socket
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.support.processes import Daemon, until
from tests.support.viewer_process import TRIES, press
from twind.client import Client, ClientError

STILL = 1e-7  # rad: less is no motion


class CuttableLine:
    """A TCP relay to a port of this machine, as `ssh -L` is one; `cut` drops all that passes, both ways."""

    def __init__(self, port: int) -> None:
        self._to = port
        self._open = threading.Event()
        self._open.set()
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def cut(self) -> None:
        """Hold back all bytes from now on: connections stay open and silent."""
        self._open.clear()

    def mend(self) -> None:
        """Deliver what was held back, and all that follows: as a network does that sends packets again."""
        self._open.set()

    def close(self) -> None:
        self.mend()
        self._listener.close()

    def _accept(self) -> None:
        while True:
            try:
                near, _ = self._listener.accept()
            except OSError:
                return
            far = socket.create_connection(("127.0.0.1", self._to))
            for one, other in ((near, far), (far, near)):
                threading.Thread(target=self._carry, args=(one, other), daemon=True).start()

    def _carry(self, one: socket.socket, other: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while data := one.recv(65536):
                self._open.wait()
                other.sendall(data)
        with contextlib.suppress(OSError):
            other.shutdown(socket.SHUT_WR)


@dataclass
class CommandedPosition:
    """The goal of one joint as the daemon reports it in every tick."""

    daemon: Daemon
    joint: str
    rows: list[tuple[float, float]] = field(default_factory=list)  # s monotonic, rad

    def __post_init__(self) -> None:
        self._client = Client(str(self.daemon.sockets), name="observe")
        threading.Thread(target=self._take, daemon=True).start()
        until(lambda: self.rows, 5.0, "the first goal")

    def _take(self) -> None:
        with contextlib.suppress(ClientError):
            for message in self._client.stream("Monitor", topics=["state"], rate=100.0):
                rows = {row["name"]: row for row in message["joints"]}
                self.rows.append((float(message["time"]), float(rows[self.joint]["goal"])))

    def close(self) -> None:
        self._client.cut()

    def is_moving(self) -> bool:
        """It changed in the last 0.1 s."""
        return self.last_change() > time.monotonic() - 0.1

    def last_change(self) -> float:
        """When it changed last, s monotonic; 0: never."""
        rows = list(self.rows)
        changes = (
            after[0]
            for before, after in zip(rows[-2::-1], rows[:0:-1], strict=True)
            if abs(after[1] - before[1]) > STILL
        )
        return next(changes, 0.0)


def take_lease(page: Any, running: Daemon) -> None:
    """Take the lease for this page, and wait until its buttons may move the robot."""
    take = page.get_by_role("button", name="Take the lease ...", exact=True)
    until(lambda: take.is_enabled(), 30.0, "the lease may be taken")
    press(page, "Take the lease ...")
    press(page, "Take it")
    page.locator("[data-twind-key]").wait_for(state="attached", timeout=30_000)
    until(lambda: running.status()["lease"], 5.0, "the lease")


def hold(page: Any, goal: CommandedPosition, name: str) -> None:
    """Press the pointer on a button and leave it there, until the robot moves. A busy machine may need more."""
    button = page.get_by_label(name, exact=True)
    box = button.bounding_box()
    for _ in range(TRIES):
        page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        page.mouse.down()
        with contextlib.suppress(AssertionError):
            until(goal.is_moving, 3.0, "the held joint")
            return
        print("pressed again:", page.locator("[data-twind-answer]").all_inner_texts())
        page.mouse.up()
    raise AssertionError(f"{name}: nothing moved")


def processes_of(home: str) -> list[int]:
    """Processes whose HOME is this folder: those of one browser."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if f"HOME={home}".encode() in (folder / "environ").read_bytes().split(b"\0"):
                found.append(int(folder.name))
    return found


@contextlib.contextmanager
def frozen(processes: list[int]) -> Iterator[None]:
    """They are stopped by SIGSTOP until the end of the block."""
    for process in processes:
        os.kill(process, signal.SIGSTOP)
    try:
        yield
    finally:
        for process in processes:
            with contextlib.suppress(ProcessLookupError):
                os.kill(process, signal.SIGCONT)
