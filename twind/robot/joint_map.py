"""The joints of a robot in one fixed order, and the place of each on its bus."""

import difflib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from twind.robot.arrays import Bools, Floats, Ints
from twind.robot.measured_travel import MeasuredTravel
from twind.robot.transmission import MappedTransmission

SIMILAR = 3  # names in a message


def similar_joints(name: str, names: Sequence[str]) -> str:
    """Return a remedy for an unknown joint: at most three similar names, or the first names of the robot."""
    near = difflib.get_close_matches(name, names, SIMILAR)
    if near:
        return f"nearest: {', '.join(near)}"
    left = len(names) - SIMILAR
    return f"the joints are {', '.join(names[:SIMILAR])}" + (f" and {left} more" if left > 0 else "")


@dataclass(frozen=True)
class JointBusMap:
    """The joints of one bus, in the order of its ids, and the factors from counts to SI. Arrays are (m,).

    position = (ticks - zero) * scale; velocity = raw * velocity_scale; effort = raw * effort_scale.
    """

    name: str
    joints: Ints  # place of each in JointMap order
    ids: tuple[int, ...]
    zero: Ints  # ticks at joint angle 0
    scale: Floats  # rad per tick, signed: sign / ratio * 2π / ticks_per_turn
    velocity_scale: Floats  # rad/s per count, signed
    effort_scale: Floats  # N·m per count, signed; NaN where the actuator reports none
    lower: Ints  # ticks: the smallest goal that may ever be sent (WIRE_CLAMP)
    upper: Ints  # ticks: the largest
    fastest: Floats  # ticks/s that the motor turns at most, by its type (SENSE_JUMP)
    load_scale: Floats | None = None  # share of the current limit per count of effort; NaN unknown; None: all
    linked: tuple[
        MappedTransmission, ...
    ] = ()  # transmissions; what the factors give of their rows is their actuators'

    def turned(self, shift: Ints) -> "JointBusMap":
        """Return the same joints in counts of the wire, which are `shift` (m,) ticks smaller."""
        return replace(self, zero=self.zero - shift, lower=self.lower - shift, upper=self.upper - shift)


@dataclass(frozen=True)
class JointMap:
    """Joints in one order, names at the edges only. `calibrated` (n,): the joint has a measured zero."""

    names: tuple[str, ...]
    buses: tuple[JointBusMap, ...]
    calibrated: tuple[bool, ...]
    turns: MeasuredTravel | None = None  # data of the turn of each actuator; None: counts are used as read
    unwatched: tuple[int, ...] = ()  # joints whose actuator cannot report that its own watchdog is armed

    def __len__(self) -> int:
        return len(self.names)

    @cached_property
    def linked(self) -> tuple[MappedTransmission, ...]:
        """Transmissions of all buses; their rows are places in this order."""
        return tuple(replace(each, rows=bus.joints[each.rows]) for bus in self.buses for each in bus.linked)

    @property
    def transmission_groups(self) -> tuple[Ints, ...]:
        """Places of the joints of each transmission."""
        return tuple(each.rows for each in self.linked)

    @cached_property
    def _places(self) -> dict[str, int]:
        return {name: place for place, name in enumerate(self.names)}

    def on_bus(self, name: str) -> Bools:
        """Return the joints (n,) of the bus `name`."""
        found = np.zeros(len(self), np.bool_)
        for bus in self.buses:
            if bus.name == name:
                found[bus.joints] = True
        return found

    def place(self, name: str) -> int:
        """Return the place of a joint. Raises KeyError whose text names the nearest spellings."""
        try:
            return self._places[name]
        except KeyError:
            raise KeyError(f"no joint {name!r}; {similar_joints(name, self.names)}") from None
