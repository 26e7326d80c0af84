"""Serial port as a `ByteTransport`: pyserial opens and configures it, then the raw descriptor is used.

The port is opened exclusively. The flock decides, since root bypasses TIOCEXCL; TIOCEXCL excludes programs
that do not use the flock.
"""

import errno
import fcntl
import grp
import os
import select
import stat
import struct
import sys
import termios
import threading
from contextlib import suppress
from math import inf
from pathlib import Path

import serial

from twind_drivers.bus import PortError, PortErrorCause
from twind_drivers.byte_transport import output_full
from twind_drivers.ports.arrival_signal import ArrivalSignal
from twind_drivers.ports.port_holder import holder

GONE = frozenset({errno.EIO, errno.ENXIO, errno.ENODEV, errno.EBADF})
UNANNOUNCED = 10  # reads in a row without an announcement, after which a port is asked whether it is there
SCRATCH = 4096  # bytes discarded per read while draining
TCGETS2 = 0x802C542A  # x86 and ARM; reads the speed that the kernel set, in bit/s
SPEED_AT = 40  # bytes into struct termios2: 4 flags, line, 19 control characters, input and output speed
BAUD_TOLERANCE = 0.025  # of the rate; a UART of 10 bits a byte loses its place near 5 % of both ends together


PTY = "/dev/pts/"  # ports that a program serves, as virtual servos do
LEAVING = 0.01  # s that closing waits for the last packet to leave

_closing: set[str] = set()  # paths of ports whose closing waits in the kernel


class SerialTransport:
    """Open serial port, 8N1, raw, non-blocking.

    `latency_ms`: reading of the adapter's latency timer, ms; None if there is none (a pty, an on-board port).
    `warning`: a fault under which the port still works, with its remedy; empty: none.
    """

    def __init__(self, path: str, baud: int, *, by_signal: bool = False) -> None:
        """Open `path`. Raises PortError with cause and remedy.

        `by_signal`: waits for bytes end in time whatever else the machine computes (`ArrivalSignal`). Then
        only the thread that opened the port may use it, and a hang-up ends no wait: the next call that is no
        read reports it, or one of the next `UNANNOUNCED` reads. Of a taken port only the holder of a flock
        is named, since a search among all processes would last several ticks.
        """
        self.name = path
        self.baud = baud
        self._path = os.path.realpath(path)
        self._port = _open(path, baud, search=not by_signal)
        self._fd: int = self._port.fileno()
        os.set_blocking(self._fd, False)
        pty = self._path.startswith(PTY)
        self.holds = not pty  # a pty passes bytes on at once
        self._loss = "its program has ended?" if pty else "adapter unplugged?"
        self._waiting = bytearray(4)  # result of FIONREAD and TIOCOUTQ
        self._scratch = memoryview(bytearray(SCRATCH))
        self._arrivals: ArrivalSignal | None = None
        self._unannounced = 0  # reads in a row
        try:
            # A pty keeps the flag while its other side is open: after a killed holder nobody could open it.
            if self.holds:
                self._query_kernel(termios.TIOCEXCL, "open")
            self._check_speed(baud)
        except PortError:
            self.close()
            raise
        self.latency_ms = self._lower_latency()
        self.warning = _slow_timer(os.path.basename(self._path), self.latency_ms)
        if by_signal:
            try:
                self._arrivals = ArrivalSignal(self._fd)
            except OSError as error:
                told = f"waits for its bytes may last longer beside programs that compute: no signal: {error}"
                self.warning = "; ".join(filter(None, (self.warning, told)))

    def fileno(self) -> int:
        """Return the descriptor to poll; -1 once closed."""
        return self._fd if self._arrivals is None else self._arrivals.fd

    def arrival(self) -> float:
        """Return `inf` (unknown): `poll` reports arrivals."""
        return inf

    def write(self, data: bytes | bytearray | memoryview) -> None:
        """Send all of `data` in one system call. Raises PortError.

        Kind OUTPUT_FULL: not all of it was taken. The rest of a packet must not leave before the next one, so
        the output is dropped.
        """
        try:
            taken = os.write(self._fd, data)
        except BlockingIOError:
            taken = 0
        except OSError as error:
            raise self._make_lost_error("write", error) from error
        if taken != len(data):
            waiting = max(self.backlog(), taken)
            self.flush()
            raise output_full(self.name, waiting, len(data))

    def read_into(self, buffer: memoryview) -> int:
        """Bytes taken without blocking; 0 if none are there. Raises PortError of kind LOST."""
        if not len(buffer):
            return 0
        arrivals = self._arrivals
        if arrivals is not None and not arrivals.take():
            self._unannounced += 1
            if self._unannounced >= UNANNOUNCED:
                self._unannounced = 0
                self.backlog()
            return 0
        self._unannounced = 0
        try:
            count = os.readv(self._fd, (buffer,))
        except BlockingIOError:
            return 0
        except OSError as error:
            raise self._make_lost_error("read", error) from error
        if count == 0:  # VMIN is 1, so nothing to read is EAGAIN and 0 is the end
            raise PortError(self.name, f"hung up ({self._loss})", kind=PortErrorCause.LOST)
        if arrivals is not None and count == len(buffer):
            arrivals.repeat()
        return count

    def backlog(self) -> int:
        """Bytes written that have not left yet (TIOCOUTQ). Raises PortError of kind LOST."""
        return self._query_kernel(termios.TIOCOUTQ, "write")

    def flush(self) -> None:
        """Throw away what has not left yet (TCOFLUSH). Raises PortError of kind LOST."""
        try:
            termios.tcflush(self._fd, termios.TCOFLUSH)
        except termios.error as error:  # no OSError, but a number and a text as well
            raise self._make_lost_error("write", OSError(*error.args)) from error
        except ValueError as error:  # no descriptor any more
            raise self._make_lost_error("write", OSError(errno.EBADF, "")) from error

    def set_baud(self, baud: int) -> None:
        """Change the rate of the open port; bytes under way are lost. Raises PortError."""
        if baud < 1:  # 0 would hang up
            raise PortError(self.name, f"baud rate {baud} is not supported: it must be positive")
        self._query_kernel(termios.FIONREAD, "read")  # a lost port raises here; pyserial's error is ambiguous
        try:
            self._port.baudrate = baud
        except (ValueError, OverflowError, OSError, termios.error) as error:
            raise PortError(self.name, f"baud rate {baud} is not supported: {error}") from error
        self._check_speed(baud)
        self.baud = baud

    def drain(self, thrown: bytearray | None = None) -> int:
        """Discard received bytes; return their number and copy them to `thrown` (the last of a long run)."""
        if self._arrivals is None and not self._query_kernel(termios.FIONREAD, "read"):
            return 0
        total = 0
        while count := self.read_into(self._scratch):
            total += count
            if thrown is not None:
                thrown[:] = self._scratch[:count] if total > 2 * SCRATCH else thrown + self._scratch[:count]
            if total > 64 * SCRATCH:  # a babbling line never runs dry
                break
        return total

    def settle(self) -> None:
        """Wait until what the kernel has received can be read, however long its worker takes."""
        if self._arrivals is not None:  # else each wait does
            poll = select.poll()
            poll.register(self._fd, select.POLLIN)
            poll.poll(0)

    def close(self) -> None:
        """Release the port. May be called twice.

        The kernel waits up to 30 s for output that an adapter does not take (closing_wait), with no regard to
        O_NONBLOCK. Such a port is released in the background.
        """
        if self._fd < 0:
            return
        waits = self._output_waits()
        if self._arrivals is not None:
            with suppress(OSError):  # of a port that is gone
                fcntl.fcntl(self._fd, fcntl.F_SETFL, fcntl.fcntl(self._fd, fcntl.F_GETFL) & ~os.O_ASYNC)
            self._arrivals.close()
            self._arrivals = None
        self._fd = -1
        if not waits:
            self._port.close()
            return
        _closing.add(self._path)
        worker = threading.Thread(target=self._release, name=f"close {self.name}", daemon=True)
        try:
            worker.start()
        except RuntimeError:  # no further thread is permitted: it is waited for
            self._release()
        else:
            worker.join(LEAVING)

    def _output_waits(self) -> bool:
        try:
            return self.backlog() > 0
        except PortError:  # it is gone, and nothing waits for it
            return False

    def _release(self) -> None:
        try:
            self._port.close()
        finally:  # else it could never be opened again
            _closing.discard(self._path)

    def _make_lost_error(self, what: str, error: OSError) -> PortError:
        gone = "closed" if self._fd < 0 else self._loss
        hint = f" ({gone})" if error.errno in GONE else ""
        return PortError(
            self.name, f"{what} failed: {os.strerror(error.errno or 0)}{hint}", kind=PortErrorCause.LOST
        )

    def _query_kernel(self, question: int, what: str) -> int:
        try:
            fcntl.ioctl(self._fd, question, self._waiting)
        except OSError as error:
            raise self._make_lost_error(what, error) from error
        except ValueError as error:  # no descriptor any more
            raise self._make_lost_error(what, OSError(errno.EBADF, "")) from error
        return int.from_bytes(self._waiting, sys.byteorder)

    def _check_speed(self, baud: int) -> None:
        """Check the speed that the kernel has set: a kernel driver may round or ignore the requested one."""
        answer = bytearray(64)
        try:
            fcntl.ioctl(self._fd, TCGETS2, answer)
        except OSError:
            return  # no such ioctl on this platform: rely on the call that set the speed
        (real,) = struct.unpack_from("=I", answer, SPEED_AT)
        if abs(real - baud) > BAUD_TOLERANCE * baud:
            raise PortError(self.name, f"baud rate {baud} is not supported: the adapter makes it {real}")

    def _lower_latency(self) -> int | None:
        """Request 1 ms and return the timer read back: the ioctl may have no effect (DynamixelSDK PR 116)."""
        with suppress(OSError, ValueError, NotImplementedError):  # a pty: ENOTTY, as ValueError
            self._port.set_low_latency_mode(True)
        timer = Path("/sys/class/tty") / os.path.basename(self._path) / "device/latency_timer"
        try:
            return int(timer.read_text())
        except (OSError, ValueError):
            return None


def _slow_timer(tty: str, latency_ms: int | None) -> str:
    """Return the remedy for a latency timer above 1 ms; empty for 1 ms or no timer."""
    if latency_ms is None or latency_ms <= 1:
        return ""
    timer = f"/sys/bus/usb-serial/devices/{tty}/latency_timer"
    return (
        f"the adapter's latency timer is {latency_ms} ms, so every answer comes up to that much late; "
        f"`echo 1 | sudo tee {timer}`, or `sudo setserial /dev/{tty} low_latency`; for good, the udev rule "
        'SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", ATTR{latency_timer}="1"'
    )


def _open(path: str, baud: int, *, search: bool) -> serial.Serial:
    if os.path.realpath(path) in _closing:  # to open it would wait as long
        raise PortError(
            path, "is still being closed, as its adapter takes no bytes: unplug it, plug it in again"
        )
    try:
        node = os.stat(path)
    except FileNotFoundError:
        if os.path.realpath(path).startswith(PTY):
            raise PortError(path, "no such port: the program that served it has ended") from None
        near = sorted(str(each) for each in Path("/dev").glob("tty[UA][SC][BM]*"))
        there = f"; there are: {', '.join(near)}" if near else "; no USB serial adapter is plugged in"
        raise PortError(path, f"no such port{there}") from None
    except OSError as error:
        raise PortError(path, f"cannot be examined: {os.strerror(error.errno or 0)}") from error
    if not stat.S_ISCHR(node.st_mode):
        raise PortError(path, "is not a character device, so it is no serial port")
    if baud < 1:
        raise PortError(
            path, f"baud rate {baud} is not supported: it must be positive", PortErrorCause.BAUD_RATE
        )
    try:
        # inter_byte_timeout=0 sets VMIN 1, VTIME 0: then a read of 0 bytes can only mean a hang-up
        return serial.Serial(path, baud, timeout=0, inter_byte_timeout=0, exclusive=True)
    except (ValueError, OverflowError, termios.error) as error:
        raise PortError(
            path, f"baud rate {baud} is not supported: {error}", PortErrorCause.BAUD_RATE
        ) from error
    except OSError as error:  # serial.SerialException is one
        if error.errno in (errno.EBUSY, errno.EAGAIN):
            taken = f"in use by {holder(path, search=search)}; stop it first"
            raise PortError(path, taken, PortErrorCause.IN_USE) from error
        if "baud" in str(error).lower():  # pyserial has no code for it
            raise PortError(
                path, f"baud rate {baud} is not supported: {error}", PortErrorCause.BAUD_RATE
            ) from error
        raise PortError(path, _reason(path, node, error)) from error


def _reason(path: str, node: os.stat_result, error: OSError) -> str:
    if error.errno == errno.EPERM:  # never the file's mode (open(2)): a device list, of a unit or a container
        return (
            "the service or container that this runs in leaves out this device: `systemctl edit` its unit, "
            f"[Service] DeviceAllow={path} rw (and that of its fail-safe, `twind-failsafe@`)"
        )
    if error.errno == errno.EACCES:
        try:
            group = grp.getgrgid(node.st_gid).gr_name
        except KeyError:
            group = str(node.st_gid)
        return (
            f"no permission: it belongs to group {group!r} (usually 'dialout'); "
            f"`sudo usermod -aG {group} $USER`, then log in again"
        )
    if "configure" in str(error) and error.errno is None:  # pyserial has no code for it
        return f"is not a serial port: {error}"
    return f"cannot be opened: {error}"
