"""Duration of a point-to-point move that names none. Standard library only."""

from collections.abc import Iterable

SHORTEST = 1.0  # s
PACE = 2.0  # s per rad: a cubic then peaks at 0.75 rad/s


def move_duration(distances: Iterable[float]) -> float:
    """Return a slow duration (s) for the longest of the distances (rad)."""
    return max([SHORTEST, *(PACE * abs(distance) for distance in distances)])
