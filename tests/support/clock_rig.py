"""Helpers shared by the computed and the real-time tests of clock."""

import os
from math import inf


class Coming:
    """Bytes that arrive at a known time."""

    def __init__(self, at: float) -> None:
        self.at = at

    def fileno(self) -> int:
        return -1

    def arrival(self) -> float:
        return self.at


class Pipe:
    """The reading end of a real pipe."""

    def __init__(self) -> None:
        self.ours, self.theirs = os.pipe()

    def fileno(self) -> int:
        return self.ours

    def arrival(self) -> float:
        return inf

    def close(self) -> None:
        for fd in (self.ours, self.theirs):
            if fd >= 0:
                os.close(fd)


class Later(Coming):
    """Without a descriptor, and it counts how often it was asked."""

    asked = 0

    def arrival(self) -> float:
        self.asked += 1
        return self.at
