"""Descriptors kept back, so that somebody who wants to stop the robot is let in when all others are used up.

Front process; knows no client.
"""

import contextlib
import os


class Spares:
    """At most `most` descriptors that are good for nothing but to be given up."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._kept: list[int] = []
        self.refill()

    def give(self) -> bool:
        """Close one, so that its number is free; False when none is left."""
        if not self._kept:
            return False
        os.close(self._kept.pop())
        return True

    def refill(self) -> bool:
        """Take back what was given, as far as there is anything to take; True when all are there."""
        with contextlib.suppress(OSError):
            while len(self._kept) < self._most:
                self._kept.append(os.open(os.devnull, os.O_RDONLY | os.O_CLOEXEC))
        return len(self._kept) == self._most

    def close(self) -> None:
        """Keep none."""
        while self.give():
            pass
