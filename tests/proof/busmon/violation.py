"""Violations and packets, as the monitors of both kinds of bus keep them, and the times that both allow."""

from dataclasses import dataclass
from typing import NamedTuple

SILENCE = 0.06  # s between two packets of an armed bus (W7)
UNFINISHED = 0.05  # s that the rest of a packet may take (W8)
ALONE = 0.1  # s without a goal, from which on a device without a watchdog counts as one that has tripped
BARE = 0.02  # s that a watchdog may be off under torque, while it is set anew (W7)
KEPT = 200  # packets
MOST = 1000  # violations that are kept


@dataclass(frozen=True)
class Violation:
    """A broken rule."""

    rule: str  # W1 .. W11
    time: float  # s
    id: int | None
    text: str

    def __str__(self) -> str:
        who = "" if self.id is None else f" id {self.id}"
        return f"{self.time:.6f} {self.rule}{who}: {self.text}"


class Seen(NamedTuple):
    """A packet, or bytes, that went by."""

    time: float
    way: str  # > to the servos, < from them
    data: bytes

    def __str__(self) -> str:
        return f"{self.time:.6f} {self.way} {self.data.hex(' ')}"
