"""The front as a child of the loop, supervised by heartbeat and restarted when it dies.

It is started by exec, never by fork, with normal scheduling and in its own session (Ctrl-C reaches the loop
only). It gets no bus descriptor: all descriptors of the loop are close-on-exec.
"""

import contextlib
import os
import select
import signal
import socket
from collections.abc import Mapping
from pathlib import Path

from twind.listening_sockets import Listener
from twind.loop.ipc.child_process import FIRST, spawn
from twind.loop.ipc.former_flight_recorder import FormerFlightRecorder

# s without a heartbeat: the front is killed and started anew, as a hanging front serves no client
HEARTBEAT = 2.0
GRACE = 10.0  # s a new front may take to its first heartbeat
LATER = 1.0  # s until the next attempt when a front could not be started; an attempt costs time of a tick
LAST_WORDS = 4.0  # s that a front has to end by itself: it may have a flight recorder to write
# s between a front's end and the next start; doubled for each that lived less than GRACE, as a start costs
# CPU
AGAIN = 0.2
AGAIN_MOST = 5.0  # s between two starts of fronts that die young
HANDED = 6  # descriptors that a child may be given: link, briefing, two sockets, two flight recorders


class FrontProcess:
    """One front at a time. `socket` is the loop's end of the link, None while there is no front."""

    def __init__(
        self,
        briefing: int,
        listeners: Mapping[str, Listener],
        flight: int | None = None,
        folder: Path | None = None,
        crash_recording: FormerFlightRecorder | None = None,
    ) -> None:
        """`listeners` by name are removed with `close`. `flight`: descriptor of the flight recorder.

        `folder`: where the recordings of `flight` and `crash_recording` are written.
        """
        self._briefing = briefing
        self._listeners = dict(listeners)
        self._flight = flight
        self._folder = folder
        self.wreck = crash_recording or FormerFlightRecorder(None)
        self.ended_well = False  # the last front ended on request with exit code 0
        self._cpus = os.sched_getaffinity(0)  # from before the loop was pinned: a front may run on any core
        self.socket: socket.socket | None = None
        self.pid: int | None = None
        self.starts = 0
        self.fate = ""  # how the last front ended
        self._alive_until = 0.0
        self._start_at = 0.0
        self._pause = 0.0
        self._born: float | None = None  # None: the pause after its end is settled

    def set_briefing(self, briefing: int) -> None:
        """Set the briefing of fronts started from now on: a sealed memfd, which this object closes."""
        os.close(self._briefing)
        self._briefing = briefing

    def rebound(self, name: str, listener: Listener) -> None:
        """Give `listener` to the fronts started from now on, in place of the socket of that name."""
        self._listeners[name].close()
        self._listeners[name] = listener

    def close(self) -> None:
        """Close the listening sockets and remove their files. Clients that wait in them are refused."""
        for listener in self._listeners.values():
            listener.remove()

    def start(self, now: float) -> None:
        """Start a front. The old one must be gone. Raises OSError, MemoryError without side effects."""
        self.wreck.offer()
        inner, outer = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            with outer:
                self.pid = self._spawn(inner, outer)
        except (OSError, MemoryError):
            inner.close()
            raise
        self.socket = inner
        self.starts = self.starts + 1
        self._alive_until = now + GRACE
        self._born = now
        self.wreck.taken()

    def _spawn(self, inner: socket.socket, outer: socket.socket) -> int:
        inner.setblocking(False)
        for end in (inner, outer):
            with contextlib.suppress(OSError):
                end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 20)
        # Its parent by number: `twindctl estop` distinguishes a daemon from a process that adopted an orphan.
        arguments = ["-m", "twind.front", "--parent", str(os.getpid())]
        arguments += [] if self._folder is None else ["--folder", str(self._folder)]
        for name, listener in self._listeners.items():
            arguments += [f"--{name}-file", listener.label]
        handed = {"link": outer.fileno(), **self._handed()}
        for place, name in enumerate(handed, FIRST):
            arguments += [f"--{name}", str(place)]
        return spawn(arguments, list(handed.values()), self._cpus)

    def _handed(self) -> dict[str, int]:
        """Return the descriptors of a front besides its link, by option name."""
        optional = {"flight": self._flight, "wreck": self.wreck.fd}
        sockets = {name: listener.bound.fileno() for name, listener in self._listeners.items()}
        present = {name: fd for name, fd in optional.items() if fd is not None}
        return {"briefing": self._briefing, **sockets, **present}

    def alive(self, now: float) -> None:
        """Note a heartbeat."""
        self._alive_until = now + HEARTBEAT

    def overdue(self, now: float) -> bool:
        """Check whether the heartbeat is overdue."""
        return self.pid is not None and now > self._alive_until

    def end(self, now: float) -> None:
        """Kill the front if it runs; the next start is due soon, later where fronts die young."""
        if self.socket is not None:
            self.socket.close()
            self.socket = None
        if self.pid is not None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.pid, signal.SIGKILL)
        if self._born is not None:
            young = now - self._born < GRACE
            self._pause = min(self._pause * 2, AGAIN_MOST) if young and self._pause else AGAIN
            self._born = None
        self._start_at = now + (self._pause or AGAIN)

    def finish(self) -> None:
        """Close the link: the front writes its last lines and ends; it is killed if it does not."""
        if self.socket is not None:
            self.socket.close()
            self.socket = None
        if self.pid is not None:
            pidfd = os.pidfd_open(self.pid)
            gone, _, _ = select.select([pidfd], [], [], LAST_WORDS)
            os.close(pidfd)
            if not gone:
                os.kill(self.pid, signal.SIGKILL)
            _, status = os.waitpid(self.pid, 0)
            self.ended_well = status == 0
            self.pid = None

    def postpone(self, now: float) -> None:
        """Delay the next attempt after a failed start."""
        self._start_at = now + LATER

    def reap(self) -> bool:
        """Collect an ended front without waiting; True when it had ended."""
        if self.pid is None:
            return False
        try:
            ended, status = os.waitpid(self.pid, os.WNOHANG)
        except ChildProcessError:
            ended = self.pid
            status = 0
        if ended:
            code = os.waitstatus_to_exitcode(status)
            self.fate = f"({ended}) ended with {f'signal {-code}' if code < 0 else f'code {code}'}"
            self.pid = None
        return bool(ended)

    def due(self, now: float) -> bool:
        """Check that there is no front and that it is time to start one."""
        return self.pid is None and now >= self._start_at
