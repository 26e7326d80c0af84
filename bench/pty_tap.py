"""A wire tap: a pseudo-terminal between the daemon and its virtual servos that keeps when each write came."""

import errno
import os
import pty
import select
import threading
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager

import serial

GOAL_POSITION = 116  # address, X series
HEADER = bytes.fromhex("fffffd00fe")  # a packet to everybody
SYNC_WRITE = 0x83


class PtyTap:
    """Bytes both ways, at once; `writes` are the daemon's: (s, when the first byte was there, bytes)."""

    def __init__(self, port: str, baud: int) -> None:
        self._serial = serial.Serial(port, baud, timeout=0, exclusive=True)
        self._far: int = self._serial.fileno()
        os.set_blocking(self._far, False)
        self._near, other = pty.openpty()
        tty.setraw(other)
        self.path = os.ttyname(other)
        os.close(other)  # the daemon wants it for itself
        os.set_blocking(self._near, False)
        self.writes: list[tuple[float, bytes]] = []
        self._ended = False
        self._thread = threading.Thread(target=self._relay)
        self._thread.start()

    def close(self) -> None:
        """Let go of both ends."""
        self._ended = True
        self._thread.join()
        self._serial.close()
        os.close(self._near)

    def _relay(self) -> None:
        poll = select.poll()
        poll.register(self._near, select.POLLIN)
        poll.register(self._far, select.POLLIN)
        while not self._ended:
            ready = dict(poll.poll(100))
            now = time.monotonic()
            if ready.get(self._near, 0) & select.POLLIN and (data := _read(self._near)):
                self.writes.append((now, data))
                os.write(self._far, data)
            elif self._near in ready:
                time.sleep(0.005)  # nobody at the other end: a hang-up cannot be waited for
            if ready.get(self._far, 0) & select.POLLIN and (data := _read(self._far)):
                _write(self._near, data)

    def goals(self) -> list[tuple[float, bytes]]:
        """Time of each goal packet on the wire, and its rows."""
        found = []
        for when, data in self.writes:
            at = data.find(HEADER)
            while at >= 0:
                length = int.from_bytes(data[at + 5 : at + 7], "little")
                body = data[at + 7 : at + 5 + length]
                if body[:3] == bytes((SYNC_WRITE, GOAL_POSITION, 0)):
                    found.append((when, body[5:]))
                at = data.find(HEADER, at + 7)
        return found


def _read(fd: int) -> bytes:
    try:
        return os.read(fd, 1 << 16)
    except OSError as error:
        if error.errno not in (errno.EIO, errno.EAGAIN):  # EIO: the daemon has hung up
            raise
        return b""


def _write(fd: int, data: bytes) -> None:
    try:
        os.write(fd, data)
    except OSError as error:
        if error.errno not in (errno.EIO, errno.EAGAIN):
            raise


@contextmanager
def tapped(port: str, baud: int) -> Iterator[PtyTap]:
    """A tap for as long as the context lasts."""
    tap = PtyTap(port, baud)
    try:
        yield tap
    finally:
        tap.close()
