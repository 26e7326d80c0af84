"""Lines from standard input, without waiting for them. Standard library only."""

import os
import select
import sys


class KeyInput:
    """Tells whether Enter was pressed. The bytes are read past `sys.stdin`, whose buffer would hide lines."""

    def __init__(self, descriptor: int | None = None) -> None:
        """`descriptor` None: standard input, if there is one."""
        self._descriptor = _standard_input() if descriptor is None else descriptor
        self._lines = 0

    def __enter__(self) -> "KeyInput":
        return self

    def __exit__(self, *_: object) -> None:
        self._descriptor = -1

    @property
    def ended(self) -> bool:
        """True if no further line can come."""
        return self._descriptor < 0 and not self._lines

    def pressed(self) -> bool:
        """Take one line if there is one."""
        while self._descriptor >= 0 and select.select([self._descriptor], [], [], 0.0)[0]:
            data = os.read(self._descriptor, 4096)
            self._lines += data.count(b"\n")
            if not data:
                self._descriptor = -1
        taken = self._lines > 0
        self._lines -= taken
        return taken


def _standard_input() -> int:
    """The descriptor of standard input; -1: it is closed, or no file."""
    try:
        return sys.stdin.fileno()
    except (AttributeError, OSError, ValueError):
        return -1
