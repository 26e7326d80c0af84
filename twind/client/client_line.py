"""Transports of a client's messages: the daemon's socket, or another connection. Standard library only."""

import contextlib
import errno
import select
import socket
import struct
import threading
import time
from typing import Protocol

from twind.client.errors import NoDaemon
from twind.client.find_socket import how_to_start

LONGEST = 64 << 20  # bytes of one message


class ClientLine(Protocol):
    """Transport of whole messages to one daemon and back, as bytes without the final NUL.

    May be opened and closed any number of times. Only `cut` may be called from another thread.
    """

    where: str  # address of the daemon, for display

    @property
    def is_open(self) -> bool:
        """True while it is open; a lease belongs to an open line."""

    def open(self, patience: float) -> None:
        """Connect to the daemon within `patience` s; do nothing if already open. Raises NoDaemon."""

    def close(self) -> None:
        """Close the line; messages received and not taken are dropped. May be called twice."""

    def cut(self) -> None:
        """Break the line, from any thread: a waiting thread gets an end of file, and then closes it."""

    def send(self, message: bytes, patience: float) -> None:
        """Send a message. Raises TimeoutError: it is not taken. Arrival is not guaranteed."""

    def receive(self, patience: float) -> bytes:
        """Return the next message. Raises TimeoutError: none came; EOFError: the other side closed."""

    def take_received(self) -> list[bytes]:
        """Return the messages that have come already."""


class SocketLine:
    """A connection to a socket of the daemon. `where` is its path. `send` may be called from any thread."""

    def __init__(self, path: str) -> None:
        self.where = path
        self._socket: socket.socket | None = None
        self._buffer = bytearray()
        self._sending = threading.Lock()  # messages of several threads are not mixed

    @property
    def is_open(self) -> bool:
        """True if the daemon had not closed the connection at its last use."""
        return self._socket is not None

    def open(self, patience: float) -> None:
        """Connect. Raises NoDaemon."""
        if self._socket is not None:
            return
        sock = None
        try:
            sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
            # A blocking connect with SO_SNDTIMEO: Python's own time-out makes the socket non-blocking, and
            # connect then fails at once (EAGAIN) while other clients fill the listen queue.
            bound = struct.pack("ll", int(patience), int(patience % 1.0 * 1e6))
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, bound)
            sock.connect(self.where)
            sock.setblocking(False)  # a time-out of the socket would be shared by all threads
        except OSError as error:
            if sock is not None:  # else no descriptor is left
                sock.close()
            absent = isinstance(error, (FileNotFoundError, NotADirectoryError, ConnectionRefusedError))
            full = isinstance(error, BlockingIOError)
            text = f"{self.where}: {_explain_error(error, self.where)}"
            raise NoDaemon(text, absent=absent, full=full, where=self.where) from None
        self._socket = sock

    def close(self) -> None:
        """Close the connection."""
        if self._socket is not None:
            self._socket.close()
        self._socket = None
        self._buffer.clear()

    def cut(self) -> None:
        """Break the connection, from any thread."""
        sock = self._socket
        if sock is not None:
            with contextlib.suppress(OSError):  # it ended by itself
                sock.shutdown(socket.SHUT_RDWR)

    def send(self, message: bytes, patience: float) -> None:
        """Send a message. Raises TimeoutError.

        A closed connection is no error yet: messages that the daemon sent before explain why.
        """
        sock = self._socket
        if sock is None:  # closed by another thread
            return
        deadline = time.monotonic() + patience
        rest = memoryview(message + b"\0")
        with self._sending:
            while rest:
                try:
                    rest = rest[sock.send(rest) :]
                except BlockingIOError:
                    _wait(sock, select.POLLOUT, deadline)  # raises TimeoutError, out of this clause
                except (OSError, ValueError):  # closed, by the daemon or by another thread
                    return

    def is_hung_up(self) -> bool:
        """Return True if the daemon has closed the connection, and everything that it sent was read."""
        if self._socket is None or self._buffer:
            return False
        try:
            return self._socket.recv(1, socket.MSG_PEEK) == b""
        except BlockingIOError:
            return False
        except OSError:
            return True

    def receive(self, patience: float) -> bytes:
        """Return the next message. Raises TimeoutError; EOFError: connection closed, or message too long."""
        assert self._socket is not None
        deadline = time.monotonic() + patience
        searched = 0
        while (end := self._buffer.find(b"\0", searched)) < 0:
            searched = len(self._buffer)
            try:
                data = self._socket.recv(1 << 18)
            except BlockingIOError:
                _wait(self._socket, select.POLLIN, deadline)
                continue
            except OSError:
                data = b""
            if not data or searched > LONGEST:
                raise EOFError
            self._buffer += data
        message = bytes(self._buffer[:end])
        del self._buffer[: end + 1]
        return message

    def take_received(self) -> list[bytes]:
        """Return the whole messages that were read along with the last one."""
        end = self._buffer.rfind(b"\0")
        messages = bytes(self._buffer[: max(end, 0)])
        del self._buffer[: end + 1]
        return messages.split(b"\0") if end >= 0 else []


def _wait(sock: socket.socket, event: int, deadline: float) -> None:
    """Wait until the socket is ready. Raises TimeoutError at `deadline` (s, monotonic)."""
    poll = select.poll()
    poll.register(sock, event)
    left = deadline - time.monotonic()
    if left <= 0.0 or not poll.poll(left * 1e3):
        raise TimeoutError


def _explain_error(error: OSError, where: str) -> str:
    if isinstance(error, FileNotFoundError | NotADirectoryError):
        return f"no daemon: there is no such socket; {how_to_start(where)}"
    if isinstance(error, ConnectionRefusedError):
        return f"no daemon: no process listens there; {how_to_start(where)}"
    if isinstance(error, PermissionError):
        return "permission denied: operators are in the group twind-operator, observers in twind-observe"
    if isinstance(error, BlockingIOError):
        return "the daemon takes no connection: too many wait, or it hangs"
    if error.errno in (errno.EMFILE, errno.ENFILE):
        return f"{error.strerror}: this program has no descriptor left for a connection"
    return f"{error.strerror or error}; {how_to_start(where)}"
