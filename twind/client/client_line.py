"""What carries a client's messages: the daemon's socket, or what else leads to one. Standard library only."""

import contextlib
import socket
import struct
import time
from typing import Protocol

from twind.client.errors import NoDaemon
from twind.client.find_socket import HOW_TO_START

LONGEST = 64 << 20  # bytes of one message


class ClientLine(Protocol):
    """Whole messages of the interface, to one daemon and back, as bytes without the NUL at their end.

    Opened and closed any number of times. Not for several threads at once, but for `cut`.
    """

    where: str  # which daemon, for people

    @property
    def is_open(self) -> bool:
        """A lease would belong to it."""

    def open(self, patience: float) -> None:
        """Reach the daemon within `patience` s. Nothing where it is open. Raises NoDaemon."""

    def close(self) -> None:
        """Hang up; what has come and was not taken is forgotten. May be called twice."""

    def cut(self) -> None:
        """Break it, from any thread: who waits hears that the other side hung up, and then closes it."""

    def send(self, message: bytes, patience: float) -> None:
        """Hand a message over. Raises TimeoutError: nobody takes it. That it arrives nobody promises."""

    def receive(self, patience: float) -> bytes:
        """The next message. Raises TimeoutError: none came; EOFError: the other side hung up."""

    def waiting(self) -> list[bytes]:
        """Messages that have come already."""


class SocketLine:
    """A connection to a socket of the daemon. `where` is its path."""

    def __init__(self, path: str) -> None:
        self.where = path
        self._socket: socket.socket | None = None
        self._buffer = bytearray()

    @property
    def is_open(self) -> bool:
        """The daemon had not hung up when it was used last."""
        return self._socket is not None

    def open(self, patience: float) -> None:
        """Connect. Raises NoDaemon."""
        if self._socket is not None:
            return
        sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            # Blocking: under a time-out of Python's own, a queue that others fill ends it at once (EAGAIN).
            bound = struct.pack("ll", int(patience), int(patience % 1.0 * 1e6))
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, bound)
            sock.connect(self.where)
            sock.settimeout(patience)
        except OSError as error:
            sock.close()
            absent = isinstance(error, (FileNotFoundError, NotADirectoryError, ConnectionRefusedError))
            full = isinstance(error, BlockingIOError)
            raise NoDaemon(f"{self.where}: {_why(error)}", absent=absent, full=full) from None
        self._socket = sock

    def close(self) -> None:
        """Hang up."""
        if self._socket is not None:
            self._socket.close()
        self._socket = None
        self._buffer.clear()

    def cut(self) -> None:
        """Break it, from any thread."""
        sock = self._socket
        if sock is not None:
            with contextlib.suppress(OSError):  # it ended by itself
                sock.shutdown(socket.SHUT_RDWR)

    def send(self, message: bytes, patience: float) -> None:
        """Raises TimeoutError. One that hung up is no error yet: what it said before that explains why."""
        assert self._socket is not None
        try:
            self._socket.settimeout(patience)
            self._socket.sendall(message + b"\0")
        except TimeoutError:
            raise
        except OSError:
            pass

    def receive(self, patience: float) -> bytes:
        """Raises TimeoutError; EOFError: it hung up, or its message is longer than any may be."""
        assert self._socket is not None
        deadline, searched = time.monotonic() + patience, 0
        while (end := self._buffer.find(b"\0", searched)) < 0:
            searched = len(self._buffer)
            try:
                self._socket.settimeout(max(1e-3, deadline - time.monotonic()))
                data = self._socket.recv(1 << 18)
            except TimeoutError:
                raise
            except OSError:
                data = b""
            if not data or searched > LONGEST:
                raise EOFError
            self._buffer += data
        message = bytes(self._buffer[:end])
        del self._buffer[: end + 1]
        return message

    def waiting(self) -> list[bytes]:
        """Of what was read with the last message."""
        end = self._buffer.rfind(b"\0")
        messages = bytes(self._buffer[: max(end, 0)])
        del self._buffer[: end + 1]
        return messages.split(b"\0") if end >= 0 else []


def _why(error: OSError) -> str:
    if isinstance(error, FileNotFoundError | NotADirectoryError):
        return f"no daemon: there is no such socket; {HOW_TO_START}"
    if isinstance(error, ConnectionRefusedError):
        return f"no daemon: nobody listens there; {HOW_TO_START}"
    if isinstance(error, PermissionError):
        return "permission denied: operators are in the group twind-operator, observers in twind-observe"
    if isinstance(error, BlockingIOError):
        return "the daemon takes no connection: too many wait, or it hangs"
    return f"{error.strerror or error}; {HOW_TO_START}"
