"""How often the slow registers of a bus get a turn: what loop, readers and budget agree on."""

from math import floor

UPKEEP_HZ = 100.0  # turns of upkeep a second that are enough for every bus


def upkeep_stride(rate_hz: float) -> int:
    """Cycles from one turn of a bus's upkeep to its next: 100 turns a second do, more would only cost."""
    return max(1, floor(rate_hz / UPKEEP_HZ + 1e-9))
