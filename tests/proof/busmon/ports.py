"""The two ends of the relay: the servos' port as a client of it, and a port of its own for the daemon."""

import fcntl
import os
import pty
import select
import struct
import tty
from contextlib import suppress
from pathlib import Path

# <asm-generic/ioctls.h>: any baud rate
TCGETS2 = 0x802C542A
TCSETS2 = 0x402C542B
TERMIOS2 = "IIIIB19sII"
CBAUD = 0o010017
BOTHER = 0o010000
CHUNK = 65536
FEW = 4  # processes that are looked at together


def _settings(fd: int) -> list[int]:
    return list(struct.unpack(TERMIOS2, fcntl.ioctl(fd, TCGETS2, bytes(struct.calcsize(TERMIOS2)))))


def baud_of(fd: int) -> int:
    """Rate that the port is set to."""
    return _settings(fd)[-1]


def set_baud(fd: int, baud: int) -> None:
    """Set both ways."""
    made = _settings(fd)
    made[2] = (made[2] & ~CBAUD) | BOTHER
    made[-2] = made[-1] = baud
    fcntl.ioctl(fd, TCSETS2, struct.pack(TERMIOS2, *made))


def write_all(fd: int, data: bytes) -> None:
    """All of it; a wire does not refuse bytes. Raises OSError: hung up, or full for a long time."""
    while data:
        try:
            data = data[os.write(fd, data) :]
        except BlockingIOError:
            if not select.select([], [fd], [], 0.1)[1]:
                raise


class ServoEnd:
    """The servos' port, opened as a host does."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.fd = -1

    def open(self, baud: int) -> bool:
        """Is it there?"""
        if self.fd < 0:
            try:
                self.fd = os.open(self._path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
            except OSError:
                return False
            tty.setraw(self.fd)
            set_baud(self.fd, baud)
        return True

    def close(self) -> None:
        if self.fd >= 0:
            os.close(self.fd)
            self.fd = -1


class DaemonEnd:
    """A pseudo-terminal under a link, for the daemon to open."""

    def __init__(self, link: Path) -> None:
        self._link = link
        self.fd = -1
        self.path = ""
        self.present = False  # somebody has it open
        self._poll = select.poll()

    def open(self) -> None:
        """A new one, under the same link."""
        if self.fd >= 0:
            return
        self.fd, other = pty.openpty()
        tty.setraw(other)  # stays so while our end is open
        self.path = os.ttyname(other)
        os.close(other)
        os.set_blocking(self.fd, False)
        self._poll = select.poll()
        self._poll.register(self.fd, 0)
        fresh = self._link.with_name(f".{self._link.name}.new")
        fresh.unlink(missing_ok=True)
        fresh.symlink_to(self.path)
        fresh.replace(self._link)

    def look(self) -> bool:
        """Is somebody there now?"""
        self.present = self.fd >= 0 and not self._poll.poll(0)
        return self.present

    def read(self) -> bytes:
        """Bytes that were written, also by a process that has ended since."""
        with suppress(OSError):
            return os.read(self.fd, CHUNK)
        return b""

    def close(self) -> None:
        """Hang up, as an unplugged adapter does."""
        if self.fd >= 0:
            os.close(self.fd)
            self.fd = -1
            self.present = False
            with suppress(OSError):
                if os.readlink(self._link) == self.path:
                    self._link.unlink()


class Holders:
    """Processes that have a port open, searched a few at a time: a look at all of them takes milliseconds."""

    def __init__(self) -> None:
        self._left: list[int] = []
        self._found: set[int] = set()
        self._before: set[int] = set()

    def step(self, path: str) -> list[int]:
        """Two or more processes that had it open in two rounds of looking; else none."""
        if not self._left:
            both = self._found & self._before
            self._before = self._found
            self._found = set()
            self._left = [int(name) for name in os.listdir("/proc") if name.isdigit()]
            both = {pid for pid in both if not _begins(pid, both)}
            if len(both) > 1:
                return sorted(both)
        for pid in [self._left.pop() for _ in range(min(FEW, len(self._left)))]:
            if pid != os.getpid() and _holds(pid, path):
                self._found.add(pid)
        return []


def _begins(pid: int, others: set[int]) -> bool:
    """Is it a child of one of these that runs no program of its own yet, between fork and exec?

    On a busy machine that takes seconds, and the descriptors of its parent are closed by its end alone.
    """
    with suppress(OSError, ValueError):
        parent = int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])
        lines = [Path(f"/proc/{each}/cmdline").read_bytes() for each in (pid, parent)]
        return parent in others and lines[0] == lines[1]
    return False


def _holds(pid: int, path: str) -> bool:
    with suppress(OSError):
        for fd in os.listdir(f"/proc/{pid}/fd"):
            with suppress(OSError):
                if os.readlink(f"/proc/{pid}/fd/{fd}") == path:
                    return True
    return False
