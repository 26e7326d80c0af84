"""Frames that leave a CAN bus together: one transaction, and the goals that wait for the next one. Pure."""

from dataclasses import dataclass
from math import inf

from twind_drivers.bus import Bools, Ints
from twind_drivers.ports.frame import Frames


@dataclass(frozen=True, slots=True)
class CanTransaction:
    """Frames to send, and the expected replies. Arrays (m,)."""

    frames: Frames
    expect: Ints  # frames of feedback
    registers: frozenset[tuple[int, int]] = frozenset()  # row and address of each requested register
    acks: Bools | None = None  # actuators that were written to and must reply
    states: Bools | None = None  # actuators that must report their torque

    @property
    def waits(self) -> bool:
        """Return True if any reply is expected."""
        some = self.acks is not None or self.states is not None
        return some or bool(self.registers) or bool(self.expect.any())


@dataclass(slots=True)
class PendingCanGoals:
    """Commands that wait for the next cyclic request, and the actuators (m,) that they command."""

    frames: Frames
    rows: Bools
    ticks: Ints  # (m,) goals, counts
    until: float = inf  # s: not sent after this time, when they would be stale
    kept: bool = False  # repeated with each request until other goals come
