"""Pair of clock readings: wall-clock times for the monotonic ones of the daemon, for display and ROS."""

from __future__ import annotations

import time
from dataclasses import dataclass

SECOND = 1_000_000_000  # ns
STEP = 50_000_000  # ns that wall clock and monotonic one may part before it is a step


@dataclass(frozen=True, slots=True)
class ClockPair:
    """Both clocks at one moment, to convert monotonic times to wall-clock times."""

    monotonic: float  # s
    wall_ns: int  # ns since 1970

    def wall(self, monotonic: float) -> int:
        """ns since 1970 of a monotonic time (s)."""
        return self.wall_ns + round((monotonic - self.monotonic) * SECOND)

    def step(self, now: ClockPair) -> int:
        """ns by which the wall clock was set since; 0: it was not."""
        parted = now.wall_ns - self.wall(now.monotonic)
        return parted if abs(parted) > STEP else 0


def clocks() -> ClockPair:
    """Read both clocks as closely together as possible: some 4 µs."""
    best: tuple[int, ClockPair] | None = None
    for _ in range(5):
        before = time.monotonic_ns()
        wall = time.time_ns()
        after = time.monotonic_ns()
        found = ClockPair((before + after) / 2e9, wall)
        if best is None or after - before < best[0]:
            best = (after - before, found)
    assert best is not None
    return best[1]
