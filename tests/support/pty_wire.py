"""Far end of a serial port, as a pseudo-terminal at a path of its own."""

import os
import pty
import tty
from pathlib import Path


class PtyWire:
    """The port as its device sees it: bytes in and out, and its cable."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.fd, other = pty.openpty()
        tty.setraw(other)
        os.set_blocking(self.fd, False)
        path.symlink_to(os.ttyname(other))
        os.close(other)

    def read(self) -> bytes:
        try:
            return os.read(self.fd, 4096)
        except OSError:
            return b""

    def unplug(self) -> None:
        os.close(self.fd)
        self.path.unlink()
