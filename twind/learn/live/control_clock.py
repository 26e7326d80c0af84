"""Time, as whoever drives a robot in real time takes it."""

import time
from typing import Protocol


class ControlClock(Protocol):
    """Time in s, monotonic."""

    def now(self) -> float:
        """The time now."""

    def sleep_until(self, deadline: float) -> None:
        """Return at `deadline`, or at once if it has passed."""


class SystemClock:
    """This machine's: the same that its daemon has."""

    def now(self) -> float:
        """The time now."""
        return time.monotonic()

    def sleep_until(self, deadline: float) -> None:
        """Return at `deadline`, or at once if it has passed."""
        time.sleep(max(0.0, deadline - time.monotonic()))
