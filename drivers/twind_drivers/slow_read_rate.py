"""Rate of the slow reads of a bus, shared by loop, readers and budget."""

from math import floor

UPKEEP_HZ = 100.0  # turns of upkeep a second that are enough for every bus


def upkeep_stride(rate_hz: float) -> int:
    """Return the cycles between two slow reads of a bus: more than 100 reads a second would only cost."""
    return max(1, floor(rate_hz / UPKEEP_HZ + 1e-9))
