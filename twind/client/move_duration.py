"""Duration of a point-to-point move that names none. Standard library only."""

from collections.abc import Iterable, Mapping
from typing import Any

from twind.client.connection import Client

SHORTEST = 1.0  # s
PACE = 2.0  # s per rad: a cubic then peaks at 0.75 rad/s


def present_goals(client: Client) -> dict[str, float | None]:
    """Ask for the goal of each joint, or else its position, rad; None: unknown. Raises ClientError."""
    return goals_of(client.call("GetStatus", joints=True)["joints"])


def goals_of(joints: Iterable[Mapping[str, Any]]) -> dict[str, float | None]:
    """Return the goal of each `Joint` of the interface, or else its position, rad; None: unknown."""
    return {joint["name"]: joint["position"] if joint["goal"] is None else joint["goal"] for joint in joints}


def slow_duration(goals: Mapping[str, float], start: Mapping[str, float | None]) -> float:
    """Duration (s) that is slow enough for the longest way from `start` to `goals`, rad by joint."""
    ways = [abs(goal - at) for name, goal in goals.items() if (at := start.get(name)) is not None]
    return max([SHORTEST, *(way * PACE for way in ways)])
