"""Jog by a browser page: buttons that are held, a line that can be cut, and the commanded position."""

import contextlib
import socket
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from tests.support.bare_browser import BareTab
from tests.support.processes import PATIENCE, Daemon, until
from twind.client import Client, ClientError

OVER = 1.0  # s after which a motion that goes on would have been seen
STILL = 1e-7  # rad: less is no motion
MOVES = 0.2  # s


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
            try:
                far = socket.create_connection(("127.0.0.1", self._to))
            except OSError:  # the viewer is gone
                near.close()
                continue
            for one, other in ((near, far), (far, near)):
                threading.Thread(target=self._carry, args=(one, other), daemon=True).start()

    def _carry(self, one: socket.socket, other: socket.socket) -> None:
        with contextlib.suppress(OSError), one, other:
            while data := one.recv(65536):
                self._open.wait()
                other.sendall(data)
            other.shutdown(socket.SHUT_RDWR)


@dataclass
class CommandedPosition:
    """The goal of one joint as the daemon reports it in every tick."""

    daemon: Daemon
    joint: str
    rows: list[tuple[float, float]] = field(default_factory=list)  # s monotonic, rad

    def __post_init__(self) -> None:
        self._client = Client(str(self.daemon.sockets), name="observe")
        self._thread = threading.Thread(target=self._take)
        self._thread.start()
        until(lambda: self.rows, 5.0, "the first goal")

    def _take(self) -> None:
        with contextlib.suppress(ClientError), self._client:
            for message in self._client.stream("Monitor", topics=["state"], rate=100.0):
                rows = {row["name"]: row for row in message["joints"]}
                self.rows.append((float(message["time"]), float(rows[self.joint]["goal"])))

    def close(self) -> None:
        self._client.cut()
        self._thread.join()

    def is_moving(self) -> bool:
        """It changed in the last 50 ms."""
        return self.last_change() > time.monotonic() - 0.05

    def velocity(self) -> float:
        """Rad/s, of the last two ticks."""
        before, after = self.rows[-2:]
        return (after[1] - before[1]) / (after[0] - before[0])

    def last_change_after(self, event: Callable[[], object], what: str) -> float:
        """Seconds from the event to the last change in the `OVER` s after it."""
        at = time.monotonic()
        event()
        time.sleep(max(0.0, at + OVER - time.monotonic()))
        took = self.last_change() - at
        print(f"{what}: the last change of the goal came {took * 1e3:.0f} ms after the event")
        return took

    def last_change(self) -> float:
        """Return the time of its last change, s monotonic; 0: never."""
        rows = list(self.rows)
        changes = (
            after[0]
            for before, after in zip(rows[-2::-1], rows[:0:-1], strict=True)
            if abs(after[1] - before[1]) > STILL
        )
        return next(changes, 0.0)


def take_lease(page: BareTab, running: Daemon) -> None:
    """Take the lease for this page, and wait until its buttons may move the robot."""
    page.click("Take the lease ...")
    page.click("Take it")
    until(lambda: page.value("!!document.querySelector('[data-twind-key]')"), 30.0, "the key of the lease")
    until(lambda: running.status()["lease"], 5.0, "the lease")


def answers(page: BareTab) -> str:
    """Return the texts beside all buttons."""
    texts = "[...document.querySelectorAll('[data-twind-answer]')].map(each => each.textContent)"
    return str(page.value(f"{texts}.join('')"))


def middle(page: BareTab, name: str) -> tuple[float, float]:
    """Middle of the button with this label, in pixels of the page."""
    button = f"document.querySelector('[aria-label=\"{name}\"]')"
    page.value(f"{button}.scrollIntoView({{block: 'center'}})")
    box = f"{button}.getBoundingClientRect()"
    x, y, width, height = page.value(f"(box => [box.x, box.y, box.width, box.height])({box})")
    return x + width / 2, y + height / 2


def hold(page: BareTab, goal: CommandedPosition, name: str) -> tuple[float, float]:
    """Hold the pointer on a button until the robot has moved for `MOVES`; return where the pointer is.

    On a busy machine a hold lapses when the page answers too late, and the button is pressed again.
    """
    place = middle(page, name)
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        page.pointer("mouseMoved", *place)
        page.pointer("mousePressed", *place)
        with contextlib.suppress(AssertionError):
            until(goal.is_moving, 3.0, "the held joint")
            time.sleep(MOVES)
            if goal.is_moving():
                return place
        print("pressed again:", answers(page))
        page.pointer("mouseReleased", *place)
    raise AssertionError(f"{name}: it did not move for {MOVES} s")
