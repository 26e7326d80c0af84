"""Connection to the loop, the front's end of the link: commands out, news in, never blocking.

Front process.
"""

import asyncio
import select
import socket
from collections import deque
from collections.abc import Callable

from twind.exceptions import InvalidInput
from twind.link import DATAGRAM, Heartbeat, Inward, Outward, decode_news, encode

MOST = DATAGRAM // 2  # bytes of one command


class LoopConnection:
    """A SOCK_SEQPACKET socket whose other end is the loop. `ended` is called once, at end-of-file."""

    def __init__(
        self,
        sock: socket.socket,
        loop: asyncio.AbstractEventLoop,
        news: Callable[[Outward], None],
        ended: Callable[[], None],
    ) -> None:
        self._sock = sock
        self._loop = loop
        self._news = news
        self._ended = ended
        self._owed: deque[bytes] = deque()
        self._buffer = bytearray(DATAGRAM)
        self._hung_up = select.poll()
        self._hung_up.register(sock, 0)  # reports only the end, whatever is still to be read (poll(2))
        sock.setblocking(False)
        loop.add_reader(sock, self._readable)

    @property
    def is_closed(self) -> bool:
        """Return True if the loop has closed its end, or is dead; its last messages may still be unread."""
        return bool(self._hung_up.poll(0))

    def send(self, command: Inward, fd: int | None = None) -> bool:
        """One command, with a memfd beside it; False: the pipe takes none now, and nothing was sent.

        Raises InvalidInput.
        """
        data = _bounded(command)
        return not self._owed and self._send(data, fd)

    def owe(self, command: Inward) -> None:
        """A command that must not be lost: sent now, or as soon as the pipe takes it. Raises InvalidInput."""
        data = _bounded(command)
        if self._owed or not self._send(data, None):
            self._owed.append(data)
            self._loop.add_writer(self._sock, self._pay)

    def heartbeat(self) -> None:
        """Send a heartbeat. A full pipe shows the same."""
        self.send(Heartbeat())

    def _pay(self) -> None:
        while self._owed and self._send(self._owed[0], None):
            self._owed.popleft()
        if not self._owed:
            self._loop.remove_writer(self._sock)

    def _send(self, data: bytes, fd: int | None) -> bool:
        try:
            if fd is None:
                self._sock.send(data, socket.MSG_NOSIGNAL)
            else:
                socket.send_fds(self._sock, [data], [fd], socket.MSG_NOSIGNAL)
        except ConnectionError:  # the loop is gone; the reader finds that out
            return True
        except OSError:  # the pipe is full, or the kernel has no memory for it
            return False
        return True

    def _readable(self) -> None:
        for _ in range(64):  # a burst of news must not starve the clients
            try:
                size = self._sock.recv_into(self._buffer)
            except BlockingIOError:
                return
            except OSError:
                size = 0
            if size == 0:
                self._loop.remove_reader(self._sock)
                self._ended()
                return
            self._news(decode_news(bytes(memoryview(self._buffer)[:size])))


def _bounded(command: Inward) -> bytes:
    """Encode a command. Raises InvalidInput for one above MOST bytes, which the kernel would cut."""
    data = encode(command)
    if len(data) > MOST:
        raise InvalidInput(f"{len(data)} bytes, bound {MOST}")
    return data
