"""The loop's end of the link: non-blocking, bounded, and never a reason to be late.

Ticks and overviews are dropped and counted when the pipe is full. Replies and events are queued; a front
that lets the queue fill is killed and started anew, and what it was owed is gone with its connections.
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
from twind.loop.front_process import FrontProcess
from twind.memfd import sealed, unseal
from twind.standard_streams import write_line

BEHIND = 1.0  # s that a front may leave more than QUEUE unread
QUEUE = 512  # replies and events owed; a front that far behind is not coming back
LARGEST = 8 << 20  # bytes of a trajectory's arrays
PER_TICK = 64  # commands taken in one tick: a flood waits in the pipe, not in the loop


@dataclass(frozen=True, slots=True)
class ReceivedCommand:
    """A command, and the bytes of the memfd that came beside it; of a briefing the memfd itself."""

    command: Inward
    data: bytes = b""
    fd: int | None = None  # sealed, and now the receiver's to close


class ControlLink(Protocol):
    """Whoever commands the loop and hears of it, as the loop calls them: clients by a front, or nobody."""

    dropped: int  # ticks in a row that nobody took
    lost: bool  # whoever was there went since the last look; the loop clears it
    no_front: str  # why nobody can be served, for people; "": somebody can

    def supervise_front(self, now: float) -> None:
        """Once per tick: start, watch and bury who serves."""

    def set_briefing(self, briefing: int) -> None:
        """What who serves next is told: a sealed memfd, which is theirs to close."""

    def ask_reread(self) -> None:
        """The files shall be read again."""

    def commands(self, now: float) -> list[ReceivedCommand]:
        """What came since the last tick, oldest first."""

    def reply(self, reply: Reply) -> None:
        """Owed to a client."""

    def event(self, event: Event | VerdictReport) -> None:
        """Owed to the log and to whoever watches."""

    def sequence(self) -> int:
        """A number for the next event or verdict."""

    def state(self, news: Tick | Overview) -> None:
        """For who looks now, or lost."""

    def flush(self) -> None:
        """Send what is owed, as far as it goes at once."""

    def close(self) -> None:
        """The loop ends."""


Record = Callable[[EntryKind, bytes], None]


def unrecorded(_kind: EntryKind, _data: bytes) -> None:
    """Nobody writes down what goes over the link."""


class FrontLink:
    """Commands in, news out: the `ControlLink` that is a front."""

    def __init__(self, front: FrontProcess, record: Record = unrecorded) -> None:
        """`record`: who writes down what goes over the link."""
        self.front = front
        self._record = record
        self.dropped = 0
        self._queue: deque[bytes] = deque()
        self._events = 0
        self._last_words: list[ReceivedCommand] = []  # of a front that died, not yet handed on
        self._behind_since = inf  # s, since when more is owed than a living front leaves
        self.lost = False  # the front went since the last look
        self.no_front = ""  # why none could be started; "": there is one, or it was not tried yet

    # ----------------------------------------------------------------------------- the front's life

    def supervise_front(self, now: float) -> None:
        """Start, watch and bury the front; at most one of these a tick."""
        if len(self._queue) > QUEUE:
            self.flush()
        self._behind_since = min(self._behind_since, now) if len(self._queue) > QUEUE else inf
        behind = now - self._behind_since > BEHIND
        if self.front.overdue(now) or behind:
            if self.front.socket is not None:
                write_line(
                    2, "warning", "twind: the front gives no sign of life, or takes nothing: it is killed"
                )
            self._bury(now)
            if behind:  # nobody takes it, and no front may be to be had
                self._queue.clear()
        if self.front.reap():
            self._last_words = self.commands(now)  # an e-stop that it still passed on is not lost with it
            self._bury(now)
            write_line(2, "warning", f"twind: the front {self.front.fate}; another one is started")
        if self.front.due(now):
            self._start(now)

    def _start(self, now: float) -> None:
        """A front, or the reason why there is none, said here, once a reason: only fronts write the log."""
        try:
            self.front.start(now)
        except OSError as error:  # no process or descriptor to be had: the loop goes on, and tries again
            self.front.postpone(now)
            if self.no_front != str(error):
                self.no_front = str(error)
                write_line(
                    2, "error", f"twind: no client can be served, the front cannot be started: {error}"
                )
        else:
            self.no_front = ""

    def close(self) -> None:
        """Let the front read what it is owed, then end it."""
        self.flush()
        self.front.finish()

    def _bury(self, now: float) -> None:
        """What was owed to its clients is gone with them; what is said from now on is the next one's."""
        if self.front.socket is not None:
            self.lost = True
            self._queue.clear()
        self.front.end(now)

    # ----------------------------------------------------------------------------- in

    def commands(self, now: float) -> list[ReceivedCommand]:
        """What the front sent since the last tick, oldest first."""
        taken = self._last_words
        self._last_words = []
        while self.front.socket is not None and len(taken) < PER_TICK:
            try:
                incoming = self._receive(self.front.socket)
            except BlockingIOError:
                break
            except OSError:
                self._bury(now)
                break
            if incoming is None:
                self._bury(now)
                break
            self.front.alive(now)
            if isinstance(incoming.command, CrashRecordingDone):
                self.front.wreck.done()
            elif not isinstance(incoming.command, Heartbeat | Rebound):
                taken.append(incoming)
        return taken

    def _rebound(self, command: Rebound, fds: Sequence[int]) -> None:
        """Keep a socket that the front bound again, for the fronts after it. Raises ValueError."""
        if command.name not in NAMES or len(fds) != 1:
            raise ValueError(f"a rebound socket {command.name!r} with {len(fds)} descriptors")
        copy = os.dup(fds[0])
        try:
            self.front.rebound(command.name, Listener.inherited(copy, command.label))
        except (OSError, ValueError):  # no socket, or no label of one
            os.close(copy)
            raise

    def _receive(self, source: socket.socket) -> ReceivedCommand | None:
        """One datagram; None at end-of-file or when it is not one of ours."""
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
            if not (isinstance(command, Submit) and command.check_only):  # it moved nothing, and is megabytes
                self._record(EntryKind.ARRAYS, incoming.data)
            return incoming
        except (msgspec.MsgspecError, ValueError):
            return None  # a front that cannot spell is as good as dead
        finally:
            for fd in fds:
                os.close(fd)

    # ----------------------------------------------------------------------------- out

    def reply(self, reply: Reply) -> None:
        """Owed to a client: queued, sent after this tick's state."""
        self._owe(reply)

    def event(self, event: Event | VerdictReport) -> None:
        """Owed to the log and to whoever watches."""
        self._owe(event)

    def set_briefing(self, briefing: int) -> None:
        """What the next front is told: a sealed memfd, which is ours to close."""
        self.front.set_briefing(briefing)

    def ask_reread(self) -> None:
        """The front shall read the files again."""
        self._owe(ReloadWanted())

    def sequence(self) -> int:
        """A number for the next event or verdict."""
        self._events += 1
        return self._events

    def state(self, news: Tick | Overview) -> None:
        """Sent at once, or dropped and counted."""
        data = encode(news)
        self._record(EntryKind.NEWS, data)
        if not self._send(data):
            self.dropped += 1
        elif isinstance(news, Tick):
            self.dropped = 0

    def flush(self) -> None:
        """Send what is owed, as far as the pipe takes it."""
        while self._queue and self._send(self._queue[0]):
            self._queue.popleft()

    def _owe(self, news: Reply | Event | VerdictReport | ReloadWanted) -> None:
        data = encode(news)
        self._record(EntryKind.NEWS, data)
        self._queue.append(data)

    def _send(self, data: bytes) -> bool:
        if self.front.socket is None:
            return False
        try:
            self.front.socket.send(data)
        except OSError:  # full (BlockingIOError) or gone: `commands` and `tend` find out which
            return False
        return True
