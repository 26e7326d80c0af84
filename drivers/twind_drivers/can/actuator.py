"""One actuator of a CAN bus, as whoever opens the bus describes it. Pure."""

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class CanActuator:
    """Who it is and what its fields span; what it tells itself at identification replaces the ranges."""

    id: int
    feedback_id: int  # what it speaks on (Damiao: master id, register 7); the same as `id` for the others
    model: str  # a name of `can_models.py`
    position: float  # rad, symmetric about 0
    velocity: float  # rad/s
    torque: float  # N·m


def place_of(name: str, ids: Sequence[int], id: int) -> int:
    """Where on the bus an id is. Raises KeyError that lists the ids of this bus."""
    if id not in ids:
        raise KeyError(f"{name} has no id {id}; its ids are {list(ids)}")
    return list(ids).index(id)
