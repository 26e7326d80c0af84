"""Pseudo-terminal as the port of a virtual bus, like a USB adapter: baud rate, unplug, replug."""

import errno
import fcntl
import os
import pty
import select
import struct
import tty
from contextlib import suppress
from pathlib import Path

TCGETS2 = 0x802C542A  # <asm-generic/ioctls.h>: the only way to read any baud rate, 4.5 M included
TERMIOS2 = "IIIIB19sII"
CHUNK = 65536
_LOCK_FLAGS = os.O_RDONLY | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC


def _claim(link: Path) -> int:
    """Return the descriptor of the locked file beside the link; the lock ends with the process.

    The file stays: one removed and made anew could be locked twice. Raises OSError: another process serves
    it.
    """
    lock = os.open(link.with_name(f".{link.name}.lock"), _LOCK_FLAGS, 0o644)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(lock)
        if not isinstance(error, BlockingIOError):
            raise
        raise OSError(f"{link}: another twind-virtual serves it; end it, or name another --link") from None
    return lock


class VirtualPtyPort:
    """Master end of a raw pseudo-terminal. Without a host at the other end nothing is read or kept.

    The other end is not kept open here, so that a host gets the errors of a real adapter.
    """

    def __init__(self, name: str, link: Path | None) -> None:
        """Open the port; `link`: a symbolic link to keep on it, whatever its number, until `close`.

        Raises OSError, before the link is changed: another process serves it.
        """
        self.name = name
        self._link = link
        self._lock = -1 if link is None else _claim(link)
        self.path = ""
        self._fd = -1
        self._poll = select.poll()
        self.present = False  # is a host at the other end?
        self.plug()

    @property
    def fd(self) -> int:
        """Descriptor of the master end, -1 while unplugged."""
        return self._fd

    def plug(self, *, renamed: bool = False) -> None:
        """Open a new pseudo-terminal under the same link; `renamed`: with another name. Raises OSError."""
        if self._fd >= 0:
            return
        master, other = pty.openpty()
        if renamed and os.ttyname(other) == self.path:  # the number was free again: take the next
            taken = (master, other)
            master, other = pty.openpty()
            os.close(taken[0])
            os.close(taken[1])
        tty.setraw(other)  # stays so while the master is open
        self.path = os.ttyname(other)
        os.close(other)
        os.set_blocking(master, False)
        self._fd = master
        self._poll = select.poll()
        self._poll.register(master, 0)  # reports only a hang-up
        if self._link is not None:
            fresh = self._link.with_name(f".{self._link.name}.new")
            fresh.unlink(missing_ok=True)
            fresh.symlink_to(self.path)
            fresh.replace(self._link)

    def unplug(self) -> None:
        """Hang up the host's end; remove path and link."""
        if self._fd < 0:
            return
        os.close(self._fd)
        self._fd = -1
        self.present = False
        if self._link is not None and self._link.is_symlink() and os.readlink(self._link) == self.path:
            self._link.unlink()

    def close(self) -> None:
        """Unplug for good, and release the link."""
        self.unplug()
        if self._lock >= 0:
            os.close(self._lock)
            self._lock = -1

    def look(self) -> bool:
        """Return True if a host has the port open.

        Called every round, since a port without host cannot be polled.
        """
        self.present = self._fd >= 0 and not self._poll.poll(0)
        return self.present

    def baud(self) -> int:
        """Return the baud rate that the host has set."""
        raw = fcntl.ioctl(self._fd, TCGETS2, bytes(struct.calcsize(TERMIOS2)))
        return int(struct.unpack(TERMIOS2, raw)[-1])

    def read(self) -> bytes:
        """Return the bytes that the host has written; empty for none."""
        with suppress(BlockingIOError):
            try:
                return os.read(self._fd, CHUNK)
            except OSError as error:
                if error.errno != errno.EIO:  # EIO: the host has just gone
                    raise
                self.present = False
        return b""

    def write(self, data: bytes) -> None:
        """Send bytes to the host. Those that it does not read are lost, as on a wire."""
        if self.present:
            with suppress(BlockingIOError):
                os.write(self._fd, data)
