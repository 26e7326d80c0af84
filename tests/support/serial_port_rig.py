"""Helpers shared by the computed and the real-time tests of dynamixel serial port."""

import os
import pty


class Terminal:
    """A pty: `path` for the port, `master` for the other end."""

    def __init__(self) -> None:
        self.master, self.slave = pty.openpty()
        self.path = os.ttyname(self.slave)
        self.open = True

    def unplug(self) -> None:
        if self.open:
            self.open = False
            os.close(self.master)
            os.close(self.slave)
