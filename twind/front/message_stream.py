"""Message stream of one connection: messages in, a bounded queue out. Front process; no methods, no robot.

The first terminator received (NUL or newline) decides for the connection, and answers end with the same one.
Telemetry that a slow reader leaves waiting is dropped oldest first and counted. Answers are never dropped, so
no further messages are read while too many of them wait. A long path is many times the queue: it would push
out all that waits, and be pushed out by the next one. Such messages are counted separately.
"""

import asyncio
import select
import socket
from collections import deque
from typing import Protocol

QUEUE = 256 * 1024  # bytes that may wait for a reader before telemetry is dropped and calls are left unread
LARGE = QUEUE // 4  # bytes; of larger telemetry one message may wait beside these: the newest
DRAINED = QUEUE // 2  # bytes of answers at which calls are read on
PATIENCE = 2.0  # s without progress, or with too many answers waiting, before a slow reader is closed
_CHUNK = 65536


class DropCounter(Protocol):
    """Receiver of the number of messages that were dropped from its telemetry."""

    dropped: int


class StreamOwner(Protocol):
    """User of a stream: receives its messages and its end."""

    def message(self, data: bytes) -> bool:
        """Process one message; return False to read no more until `resume`."""

    def too_large(self, limit: int) -> None:
        """Report that a message is larger than `limit` bytes; nothing more is read."""

    def ended(self) -> None:
        """Report that the stream is closed; called once."""


class MessageStream:
    """A non-blocking socket in an asyncio loop. `limit`: largest message, bytes."""

    def __init__(self, sock: socket.socket, limit: int, loop: asyncio.AbstractEventLoop) -> None:
        self._sock = sock
        self._limit = limit
        self._loop = loop
        self._owner: StreamOwner | None = None
        self._terminator: bytes | None = None
        self._buffer = bytearray()
        self._searched = 0
        self._queue: deque[tuple[bytes, DropCounter | None]] = deque()
        self._queued = 0
        self._large = 0  # bytes of what is queued that are a large message of telemetry
        self._answers = 0  # bytes of what is queued that are answers
        self._answering = False  # `_rest` is of an answer
        self._over: float | None = None  # s, since when too many answers wait
        self._declined = False  # by the owner, until it calls `resume`
        self._rest = memoryview(b"")
        self._progress = 0.0
        self._reading = self._closing = False
        self.closed = False
        self.half_closed = False  # the peer sends no more; it may still read

    def start(self, owner: StreamOwner) -> None:
        """Begin to read."""
        self._owner = owner
        self._read_on()

    def close(self) -> None:
        """Close at once; what is queued is lost."""
        if self.closed:
            return
        self.closed = True
        self._read_off()
        self._loop.remove_writer(self._sock)
        self._sock.close()
        self._queue.clear()
        if self._owner is not None:
            self._owner.ended()

    def finish(self) -> None:
        """Read no more; close when all is sent."""
        self._closing = True
        self._read_off()
        if not self.backlog:
            self.close()

    # ------------------------------------------------------------------------------------------ in

    def resume(self) -> None:
        """Continue to read after `message` returned False."""
        self._declined = False
        self._read_further()

    def _read_further(self) -> None:
        if not self.closed and not self._closing and self._messages() and not self.half_closed:
            self._read_on()

    def _read_on(self) -> None:
        if not self._reading:
            self._reading = True
            self._loop.add_reader(self._sock, self._readable)

    def _read_off(self) -> None:
        if self._reading:
            self._reading = False
            self._loop.remove_reader(self._sock)

    def _readable(self) -> None:
        try:
            data = self._sock.recv(_CHUNK)
        except BlockingIOError:
            return
        except OSError:
            self.close()
            return
        if not data:
            self._end_of_file()
            return
        self._buffer += data
        if not self._messages():
            self._read_off()

    def _messages(self) -> bool:
        """Hand over what is complete; False when no more is wanted for now."""
        assert self._owner is not None
        while not self.closed and not self._closing and not self._declined and self._over is None:
            place = self._find()
            if place > self._limit or (place < 0 and len(self._buffer) > self._limit):
                self._owner.too_large(self._limit)
                return False
            if place < 0:
                return True
            data = bytes(self._buffer[:place])
            del self._buffer[: place + 1]
            self._searched = 0
            if self._terminator == b"\n" and not data.strip():
                continue
            self._declined = not self._owner.message(data)
        return False

    def _find(self) -> int:
        """Place of the next terminator, -1: none yet."""
        if self._terminator is None:
            places = [self._buffer.find(mark, self._searched) for mark in (b"\0", b"\n")]
            place = min((place for place in places if place >= 0), default=-1)
            if place >= 0:
                self._terminator = bytes(self._buffer[place : place + 1])
        else:
            place = self._buffer.find(self._terminator, self._searched)
        self._searched = len(self._buffer) if place < 0 else 0
        return place

    def drop_unfinished(self) -> int:
        """Drop what was received of a message without its terminator. Return its bytes, 0: there is none."""
        unfinished = 0 if self._find() >= 0 else len(self._buffer.strip())
        if unfinished:
            self._buffer.clear()
            self._searched = 0
        return unfinished

    def _end_of_file(self) -> None:
        """Handle end-of-file: the peer is gone, or has only sent its last request (socat, nc)."""
        self._read_off()
        self.half_closed = True
        if self.peer_gone():
            self.close()

    def peer_gone(self) -> bool:
        """Return True if the peer has closed both directions, not only its sending one."""
        poll = select.poll()
        poll.register(self._sock, 0)
        return bool(poll.poll(0))

    # ------------------------------------------------------------------------------------------ out

    @property
    def backlog(self) -> int:
        """Number of bytes that wait for the reader."""
        return len(self._rest) + self._queued

    @property
    def _unread_answers(self) -> int:
        """Number of bytes of answers that wait for the reader."""
        return self._answers + (len(self._rest) if self._answering else 0)

    def send(self, data: bytes) -> None:
        """An answer: never dropped. The terminator is added."""
        self._put(data, None)

    def publish(self, body: bytes, counter: DropCounter) -> None:
        """Telemetry: `body` is what follows `"parameters":{"dropped":N,`. May be dropped, and counted."""
        large = len(body) > LARGE
        if self._large if large else self._queued - self._large + len(body) > QUEUE:
            self._drop(len(body), large=large)
        self._put(body, counter)

    def _put(self, data: bytes, counter: DropCounter | None) -> None:
        if self.closed:
            return
        if not self.backlog:
            self._progress = self._loop.time()
        self._queue.append((data, counter))
        self._queued += len(data)
        if counter is None:
            self._answers += len(data)
        elif len(data) > LARGE:
            self._large += len(data)
        if not self._rest:
            self._write()
        if self._over is None and self._unread_answers > QUEUE:
            self._over = self._loop.time()

    def _drop(self, room: int, *, large: bool) -> None:
        """The large message that waits; or of the rest the oldest telemetry, until `room` bytes fit."""
        kept: deque[tuple[bytes, DropCounter | None]] = deque()
        while self._queue and (self._large if large else self._queued - self._large + room > QUEUE):
            data, counter = self._queue.popleft()
            if counter is None or (len(data) > LARGE) is not large:
                kept.append((data, counter))
            else:
                counter.dropped += 1
                self._gone(data)
        self._queue.extendleft(reversed(kept))

    def _gone(self, telemetry: bytes) -> None:
        """Remove a message that no longer waits."""
        self._queued -= len(telemetry)
        if len(telemetry) > LARGE:
            self._large -= len(telemetry)

    def _write(self) -> None:
        while not self.closed:
            if not self._rest:
                if not self._queue:
                    self._loop.remove_writer(self._sock)
                    if self._closing:
                        self.close()
                    return
                self._rest = memoryview(self._next())
            try:
                sent = self._sock.send(self._rest)
            except BlockingIOError:
                self._loop.add_writer(self._sock, self._write)
                return
            except OSError:
                self.close()
                return
            self._rest = self._rest[sent:]
            self._progress = self._loop.time()
            if self._over is not None and self._unread_answers <= DRAINED:
                self._over = None
                self._loop.call_soon(self._read_further)

    def _next(self) -> bytes:
        data, counter = self._queue.popleft()
        end = self._terminator or b"\0"
        self._answering = counter is None
        if counter is None:
            self._queued -= len(data)
            self._answers -= len(data)
            return data + end
        self._gone(data)
        head = b'{"continues":true,"parameters":{"dropped":%d,' % counter.dropped
        counter.dropped = 0
        return head + data + end

    def stuck(self, now: float) -> bool:
        """The reader has taken nothing of what waits, or too little of its answers, for too long."""
        idle = self.backlog > 0 and now - self._progress > PATIENCE
        return idle or (self._over is not None and now - self._over > PATIENCE)
