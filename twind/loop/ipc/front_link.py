"""The loop's end of the link to the front: non-blocking and bounded, so that it never delays a tick.

Ticks and overviews are dropped and counted when the pipe is full. Replies and events are queued. A front
that lets the queue fill is killed and started anew; its queue is dropped with its connections.
"""

import array
import os
import socket
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf
from typing import Protocol

import msgspec

from twind.flight import EntryKind
from twind.link import (
    DATAGRAM,
    ApplyChanges,
    CrashRecordingDone,
    Event,
    Heartbeat,
    Inward,
    Overview,
    Rebound,
    ReloadWanted,
    Reply,
    Submit,
    Tick,
    VerdictReport,
    decode_command,
    encode,
)
from twind.listening_sockets import NAMES, Listener
from twind.loop.ipc.front_process import FrontProcess
from twind.sealed_memfd import sealed, unseal
from twind.standard_streams import write_line

# s that a front may leave more than QUEUE unread; a front that is merely descheduled is not killed
BEHIND = 1.0
QUEUE = 512  # queued replies and events; a front that is further behind does not recover
LARGEST = 8 << 20  # bytes of a trajectory's arrays
PER_TICK = 64  # commands taken in one tick: a flood waits in the pipe, not in the loop
ALL = 4096  # commands taken of a front that is gone or is killed: more than a pipe of 2 MiB holds


@dataclass(frozen=True, slots=True)
class ReceivedCommand:
    """A command and the bytes of the memfd beside it; with a briefing the memfd itself."""

    command: Inward
    data: bytes = b""
    fd: int | None = None  # sealed; the receiver closes it


class ControlLink(Protocol):
    """Source of commands and receiver of reports, as the loop calls it: a front with clients, or none."""

    dropped: int  # ticks in a row that were not taken
    lost: bool  # the front was lost since the last check; the loop clears it
    no_front: str  # why no client can be served, text for people; "": clients can be

    def supervise_front(self, now: float) -> None:
        """Start, supervise and end the front; called once per tick."""

    def set_briefing(self, briefing: int) -> None:
        """Set the briefing of the next front: a sealed memfd, which the callee closes."""

    def ask_reread(self) -> None:
        """Request that the front reads the files again."""

    def commands(self, now: float) -> list[ReceivedCommand]:
        """Return the commands since the last tick, oldest first."""

    def reply(self, reply: Reply) -> None:
        """Queue a reply to a client."""

    def event(self, event: Event | VerdictReport) -> None:
        """Queue an event for the log and the subscribers."""

    def sequence(self) -> int:
        """Return a number for the next event or verdict."""

    def state(self, news: Tick | Overview) -> None:
        """Send the state at once, or drop it."""

    def flush(self) -> None:
        """Send the queue as far as it goes at once."""

    def close(self) -> None:
        """End the link with the loop."""


Record = Callable[[EntryKind, bytes], None]


def unrecorded(_kind: EntryKind, _data: bytes) -> None:
    """Ignore a message: no recorder is set."""


class FrontLink:
    """The `ControlLink` to a front process: commands in, reports out."""

    def __init__(self, front: FrontProcess, record: Record = unrecorded) -> None:
        """`record`: receives every message of the link."""
        self.front = front
        self._record = record
        self.dropped = 0
        self._queue: deque[bytes] = deque()
        self._events = 0
        self._last_words: list[ReceivedCommand] = []  # commands of a front that died, not yet passed on
        self._behind_since = inf  # s, since when more is queued than a living front leaves
        self.lost = False  # the front was lost since the last check
        self.no_front = ""  # why no front could be started; "": one runs, or none was tried yet

    # ----------------------------------------------------------------------------- the front's life

    def supervise_front(self, now: float) -> None:
        """Start, supervise and end the front; at most one of these a tick."""
        if len(self._queue) > QUEUE:
            self.flush()
        self._behind_since = min(self._behind_since, now) if len(self._queue) > QUEUE else inf
        behind = now - self._behind_since > BEHIND
        if self.front.overdue(now) or behind:
            if self.front.socket is not None:
                write_line(
                    2, "warning", "twind: the front sends no heartbeat, or takes nothing: it is killed"
                )
                self._last_words = self.commands(now, ALL)  # as below
            self._discard_front(now)
            if behind:  # without a front no reader would ever empty the queue
                self._queue.clear()
        if self.front.reap():
            # an e-stop that the front still passed on must not be lost, however many commands precede it
            self._last_words = self.commands(now, ALL)
            self._discard_front(now)
            write_line(2, "warning", f"twind: the front {self.front.fate}; another one is started")
        if self.front.due(now):
            self._start(now)

    def _start(self, now: float) -> None:
        """Start a front.

        Report the reason why none starts once on standard error, as only fronts write the log.
        """
        try:
            self.front.start(now)
        except (OSError, MemoryError) as error:  # the loop goes on and retries
            self.front.postpone(now)
            reason = str(error) or "no memory is left"
            if self.no_front != reason:
                self.no_front = reason
                write_line(
                    2, "error", f"twind: no client can be served, the front cannot be started: {reason}"
                )
        else:
            self.no_front = ""

    def close(self) -> None:
        """Let the front read its queue, then end it."""
        self.flush()
        self.front.finish()

    def _discard_front(self, now: float) -> None:
        """End the front and drop its queue: the clients are gone, and new messages are for the next front."""
        if self.front.socket is not None:
            self.lost = True
            self._queue.clear()
        self.front.end(now)

    # ----------------------------------------------------------------------------- in

    def commands(self, now: float, most: int = PER_TICK) -> list[ReceivedCommand]:
        """Return at most `most` commands since the last tick, oldest first, a dead front's last ones too."""
        taken = self._last_words
        self._last_words = []
        while self.front.socket is not None and len(taken) < most:
            try:
                incoming = self._receive(self.front.socket)
            except BlockingIOError:
                break
            except ConnectionResetError:
                continue  # it died with unread news; reported once, before the commands that it still sent
            except OSError:
                self._discard_front(now)
                break
            if incoming is None:
                self._discard_front(now)
                break
            self.front.alive(now)
            if isinstance(incoming.command, CrashRecordingDone):
                self.front.wreck.done()
            elif not isinstance(incoming.command, Heartbeat | Rebound):
                taken.append(incoming)
        return taken

    def _rebound(self, command: Rebound, fds: Sequence[int]) -> None:
        """Keep a socket that the front bound again, for later fronts. Raises ValueError."""
        if command.name not in NAMES or len(fds) != 1:
            raise ValueError(f"a rebound socket {command.name!r} with {len(fds)} descriptors")
        copy = os.dup(fds[0])
        try:
            self.front.rebound(command.name, Listener.inherited(copy, command.label))
        except (OSError, ValueError):  # no socket, or no valid label
            os.close(copy)
            raise

    def _receive(self, source: socket.socket) -> ReceivedCommand | None:
        """Return one datagram; None at end-of-file or for a malformed one."""
        ancillary = socket.CMSG_SPACE(array.array("i", [0]).itemsize * 4)
        data, extra, _flags, _ = source.recvmsg(DATAGRAM, ancillary)
        fds = array.array("i")
        for _level, _kind, payload in extra:
            fds.frombytes(payload[: len(payload) - len(payload) % fds.itemsize])
        try:
            if not data:
                return None
            command = decode_command(data)
            if isinstance(command, Heartbeat | CrashRecordingDone):
                return ReceivedCommand(command)
            if isinstance(command, Rebound):
                self._rebound(command, fds)
                return ReceivedCommand(command)
            self._record(EntryKind.COMMAND, data)
            if isinstance(command, ApplyChanges):
                return ReceivedCommand(command, fd=sealed(os.dup(fds[0])) if fds else None)
            if not fds:
                return ReceivedCommand(command)
            incoming = ReceivedCommand(command, unseal(fds[0], LARGEST))
            # it moved nothing and takes megabytes
            if not (isinstance(command, Submit) and command.check_only):
                self._record(EntryKind.ARRAYS, incoming.data)
            return incoming
        except (msgspec.MsgspecError, ValueError):
            return None  # a front that sends malformed messages counts as dead
        finally:
            for fd in fds:
                os.close(fd)

    # ----------------------------------------------------------------------------- out

    def reply(self, reply: Reply) -> None:
        """Queue a reply; it leaves after this tick's state."""
        self._enqueue(reply)

    def event(self, event: Event | VerdictReport) -> None:
        """Queue an event for the log and the subscribers."""
        self._enqueue(event)

    def set_briefing(self, briefing: int) -> None:
        """Set the briefing of the next front: a sealed memfd, which this object closes."""
        self.front.set_briefing(briefing)

    def ask_reread(self) -> None:
        """Request that the front reads the files again."""
        self._enqueue(ReloadWanted())

    def sequence(self) -> int:
        """Return a number for the next event or verdict."""
        self._events += 1
        return self._events

    def state(self, news: Tick | Overview) -> None:
        """Send at once, or drop and count."""
        data = encode(news)
        self._record(EntryKind.NEWS, data)
        if not self._send(data):
            self.dropped += 1
        elif isinstance(news, Tick):
            self.dropped = 0

    def flush(self) -> None:
        """Send the queue as far as the pipe takes it."""
        while self._queue and self._send(self._queue[0]):
            self._queue.popleft()

    def _enqueue(self, news: Reply | Event | VerdictReport | ReloadWanted) -> None:
        data = encode(news)
        self._record(EntryKind.NEWS, data)
        self._queue.append(data)

    def _send(self, data: bytes) -> bool:
        if self.front.socket is None:
            return False
        try:
            self.front.socket.send(data)
        except OSError:  # full (BlockingIOError) or gone: `commands` and `supervise_front` find out which
            return False
        return True
