"""Helpers shared by the computed and the real-time tests of can channels."""

import os
import pty
import select
import termios
import tty


class Terminal:
    """A pty; whoever holds `master` is the adapter."""

    def __init__(self) -> None:
        self.master, self.slave = pty.openpty()
        tty.setraw(self.slave, termios.TCSANOW)
        self.path = os.ttyname(self.slave)

    def unplug(self) -> None:
        for fd in (self.master, self.slave):
            if fd >= 0:
                os.close(fd)
        self.master = self.slave = -1

    def received(self, count: int) -> bytes:
        """`count` bytes that the adapter got."""
        got = b""
        while len(got) < count and select.select([self.master], [], [], 2.0)[0]:
            got += os.read(self.master, count - len(got))
        return got
