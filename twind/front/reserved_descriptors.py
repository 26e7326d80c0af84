"""Reserved descriptors of a front, for clients that stop the robot. Front process; independent of clients.

They are kept back, so that such a client is accepted when all other descriptors are used up.
"""

import contextlib
import os

PLACES = {"operator": 4, "observer": 16}
RESERVED = 4  # connections beyond the places of each role, for an e-stop each; the oldest makes room
_STANDING = 12  # standard streams, link, sockets, flight recorders, asyncio's epoll and pair, the journal
_PASSING = 16  # files open for a moment: a reload, a flight recorder, libraries, memfds of trajectories
NEEDED = _STANDING + sum(PLACES.values()) + RESERVED * (len(PLACES) + 1) + _PASSING  # with the spare ones


class ReservedDescriptors:
    """Reserve of at most `most` descriptors, which are closed to accept a client."""

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
