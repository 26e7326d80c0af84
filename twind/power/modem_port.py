"""Serial port of a relay or a button by `termios`: raw, 8N1, non-blocking, locked as the buses' ports are."""

import fcntl
import os
import struct
import termios

_RTS = struct.pack("I", termios.TIOCM_RTS)
_IFLAG, _OFLAG, _CFLAG, _LFLAG, _ISPEED, _OSPEED, _CC = range(7)


class ModemPort:
    """Open port. All methods raise OSError when the device is gone."""

    def __init__(self, path: str) -> None:
        """Open `path` at 9600 bit/s. Raises OSError: another process has it, or there is none."""
        self.fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            fcntl.flock(self.fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self._configure()
        except (OSError, termios.error) as error:
            os.close(self.fd)
            raise OSError(*error.args) from None

    def _configure(self) -> None:
        settings = termios.tcgetattr(self.fd)
        settings[_IFLAG] = termios.IGNBRK
        settings[_OFLAG] = 0
        # HUPCL: the kernel drops RTS when the port is closed, also by the end of a killed process.
        settings[_CFLAG] = termios.CS8 | termios.CREAD | termios.CLOCAL | termios.HUPCL
        settings[_LFLAG] = 0
        settings[_ISPEED] = settings[_OSPEED] = termios.B9600
        settings[_CC][termios.VMIN] = 1
        settings[_CC][termios.VTIME] = 0
        termios.tcsetattr(self.fd, termios.TCSANOW, settings)

    def set_rts(self, on: bool) -> None:
        """Set the line RTS."""
        fcntl.ioctl(self.fd, termios.TIOCMBIS if on else termios.TIOCMBIC, _RTS)

    def cts(self) -> bool:
        """Return the line CTS."""
        (lines,) = struct.unpack("I", fcntl.ioctl(self.fd, termios.TIOCMGET, bytes(4)))
        return bool(lines & termios.TIOCM_CTS)

    def write(self, data: bytes) -> None:
        """Send all of `data`. Raises OSError where the output is full."""
        if os.write(self.fd, data) != len(data):
            raise OSError("the device takes no bytes")

    def read(self) -> bytes:
        """Return the received bytes; empty: none. Raises OSError at a hang-up."""
        try:
            data = os.read(self.fd, 256)
        except BlockingIOError:
            return b""
        if not data:
            raise OSError("hung up")
        return data

    def drain(self) -> None:
        """Wait until all bytes have left."""
        try:
            termios.tcdrain(self.fd)
        except termios.error as error:
            raise OSError(*error.args) from None

    def close(self) -> None:
        """Close the port; RTS goes off."""
        os.close(self.fd)
