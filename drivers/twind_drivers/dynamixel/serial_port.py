"""A serial port as a `Transport`: pyserial opens and configures it, then the raw descriptor is used.

Opened exclusively: the flock decides (root gets past TIOCEXCL), TIOCEXCL keeps out those who do not ask.
"""

import errno
import fcntl
import grp
import os
import stat
import termios
from contextlib import suppress
from math import inf
from pathlib import Path

import serial

from twind_drivers.bus import PortError
from twind_drivers.dynamixel.holder import holder

GONE = frozenset({errno.EIO, errno.ENXIO, errno.ENODEV, errno.EBADF})
SCRATCH = 4096  # bytes thrown away per read while draining


class SerialTransport:
    """One open port, 8N1, raw, non-blocking.

    `low_latency`: True when the adapter's latency timer reads 1 ms, False when it is longer, None when there
    is no such timer to read (a pty, an on-board port).
    """

    def __init__(self, path: str, baud: int) -> None:
        """Open `path`. Raises PortError that says what is wrong and what to do."""
        self.name = path
        self.baud = baud
        self._path = os.path.realpath(path)
        self._port = _open(path, baud)
        self._fd: int = self._port.fileno()
        os.set_blocking(self._fd, False)
        # A pty keeps the flag while its other side is open, so a killed holder would lock everybody out.
        if not self._path.startswith("/dev/pts/"):
            fcntl.ioctl(self._fd, termios.TIOCEXCL)
        self.low_latency = self._lower_latency()
        self._waiting = bytearray(4)  # FIONREAD's answer
        self._scratch = memoryview(bytearray(SCRATCH))

    def fileno(self) -> int:
        """Descriptor to poll; -1 once closed."""
        return self._fd

    def arrival(self) -> float:
        """Unknown: poll tells."""
        return inf

    def write(self, data: bytes | bytearray | memoryview) -> None:
        """Send all of `data` in one system call. Raises PortError, `lost` unless the output is only full."""
        try:
            taken = os.write(self._fd, data)
        except BlockingIOError:
            taken = 0
        except OSError as error:
            raise self._lost("write", error) from error
        if taken != len(data):
            backlog = f"{taken} of {len(data)} bytes taken: earlier packets still wait in the port's output"
            raise PortError(self.name, backlog)

    def read_into(self, buffer: memoryview) -> int:
        """Bytes taken without blocking; 0 if none are there. Raises PortError(lost=True)."""
        try:
            count = os.readv(self._fd, (buffer,))
        except BlockingIOError:
            return 0
        except OSError as error:
            raise self._lost("read", error) from error
        if count == 0 and len(buffer):  # VMIN is 1, so nothing to read is EAGAIN and 0 is the end
            raise PortError(self.name, "hung up (adapter unplugged?)", lost=True)
        return count

    def drain(self) -> int:
        """Throw away what has arrived; bytes thrown."""
        try:
            fcntl.ioctl(self._fd, termios.FIONREAD, self._waiting)
        except OSError as error:
            raise self._lost("read", error) from error
        if not any(self._waiting):
            return 0
        thrown = 0
        while count := self.read_into(self._scratch):
            thrown += count
            if thrown > 64 * SCRATCH:  # a babbling line never runs dry
                break
        return thrown

    def close(self) -> None:
        """Let go of the port. May be called twice."""
        if self._fd >= 0:
            self._fd = -1
            self._port.close()

    def _lost(self, what: str, error: OSError) -> PortError:
        gone = "closed" if self._fd < 0 else "adapter unplugged?"
        hint = f" ({gone})" if error.errno in GONE else ""
        return PortError(self.name, f"{what} failed: {os.strerror(error.errno or 0)}{hint}", lost=True)

    def _lower_latency(self) -> bool | None:
        """Ask for 1 ms and read back what the adapter says: the ioctl alone has been seen to do nothing."""
        with suppress(OSError, ValueError, NotImplementedError):  # a pty: ENOTTY, as ValueError
            self._port.set_low_latency_mode(True)
        timer = Path("/sys/class/tty") / os.path.basename(self._path) / "device/latency_timer"
        try:
            return int(timer.read_text()) <= 1
        except (OSError, ValueError):
            return None


def _open(path: str, baud: int) -> serial.Serial:
    try:
        node = os.stat(path)
    except FileNotFoundError:
        near = sorted(str(each) for each in Path("/dev").glob("tty[UA][SC][BM]*"))
        there = f"; there are: {', '.join(near)}" if near else "; no USB serial adapter is plugged in"
        raise PortError(path, f"no such port{there}") from None
    except OSError as error:
        raise PortError(path, f"cannot be looked at: {os.strerror(error.errno or 0)}") from error
    if not stat.S_ISCHR(node.st_mode):
        raise PortError(path, "is not a character device, so it is no serial port")
    if baud < 1:
        raise PortError(path, f"baud rate {baud} is not supported: it must be positive")
    try:
        # inter_byte_timeout=0 sets VMIN 1, VTIME 0: then a read of 0 bytes can only mean a hang-up
        return serial.Serial(path, baud, timeout=0, inter_byte_timeout=0, exclusive=True)
    except (ValueError, OverflowError, termios.error) as error:
        raise PortError(path, f"baud rate {baud} is not supported: {error}") from error
    except OSError as error:  # serial.SerialException is one
        raise PortError(path, _reason(path, node, baud, error)) from error


def _reason(path: str, node: os.stat_result, baud: int, error: OSError) -> str:
    if error.errno in (errno.EBUSY, errno.EAGAIN):
        return f"in use by {holder(path)}; stop it first"
    if error.errno in (errno.EACCES, errno.EPERM):
        try:
            group = grp.getgrgid(node.st_gid).gr_name
        except KeyError:
            group = str(node.st_gid)
        return (
            f"no permission: it belongs to group {group!r} (usually 'dialout'); "
            f"`sudo usermod -aG {group} $USER`, then log in again"
        )
    if "configure" in str(error) and error.errno is None:
        return f"is not a serial port: {error}"
    if "baud" in str(error).lower():
        return f"baud rate {baud} is not supported: {error}"
    return f"cannot be opened: {error}"
