"""Description of one actuator of a CAN bus, as given when the bus is opened. Pure."""

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class CanActuatorIdentity:
    """Identity and field ranges of an actuator; ranges that it reports at identification replace these."""

    id: int
    feedback_id: int  # id of its replies (Damiao: master id, register 7); the same as `id` for the others
    model: str  # a name of `can_models.py`
    position: float  # rad, symmetric about 0
    velocity: float  # rad/s
    torque: float  # N·m


def place_of(name: str, ids: Sequence[int], id: int) -> int:
    """Return the index of an id on the bus. Raises KeyError that lists the ids of this bus."""
    if id not in ids:
        raise KeyError(f"{name} has no id {id}; its ids are {list(ids)}")
    return list(ids).index(id)
