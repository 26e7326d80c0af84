"""Layout of a policy's observation, entry by entry: the only place that defines the meaning of each number.

The same in simulation and on a robot. SI units; n is the number of joints, in the order of the robot file.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from twind.robot.arrays import Floats, frozen

BASE = 25  # entries that say how the base moves and where the soles are
COMMAND = 3
PHASE = 4


@dataclass(frozen=True, slots=True)
class ObservationPart:
    """A run of entries that belong together."""

    name: str
    size: int
    unit: str  # empty: none
    most: float  # what an entry's size is cut to: generous, or what a sensor can say
    meaning: str
    labels: tuple[str, ...]  # of its entries; empty: the joints


def _base() -> tuple[ObservationPart, ...]:
    xyz = ("x", "y", "z")
    feet = tuple(f"{side}.{axis}" for side in ("left", "right") for axis in xyz)
    return (
        ObservationPart("gyro", 3, "rad/s", 35.0, "angular velocity of the base, base frame", xyz),
        ObservationPart("acceleration", 3, "m/s²", 160.0, "accelerometer reading, base frame", xyz),
        ObservationPart("gravity", 3, "", 1.0, "direction of gravity, base frame; upright: 0 0 -1", xyz),
        ObservationPart("height", 1, "m", 5.0, "of the base above the lower sole", ("z",)),
        ObservationPart("base_velocity", 3, "m/s", 20.0, "of the base, base frame", xyz),
        ObservationPart("soles", 6, "m", 5.0, "sole positions relative to the base, base frame", feet),
        ObservationPart("sole_velocities", 6, "m/s", 50.0, "their velocities relative to the base", feet),
    )


@dataclass(frozen=True)
class ObservationLayout:
    """The observation of a robot with these joints."""

    joints: tuple[str, ...]

    @cached_property
    def parts(self) -> tuple[ObservationPart, ...]:
        """The parts in order, without a gap."""
        n = len(self.joints)
        return (
            ObservationPart("position", n, "rad", 7.0, "position less the default pose of the task", ()),
            ObservationPart("velocity", n, "rad/s", 50.0, "velocity", ()),
            ObservationPart("action", n, "", 1.0, "the last action", ()),
            ObservationPart("lag", n, "rad", 7.0, "the target sent last less the position", ()),
            *_base(),
            ObservationPart(
                "command", COMMAND, "m/s, rad/s", 5.0, "commanded velocity", ("forward", "left", "turn")
            ),
            ObservationPart(
                "phase",
                PHASE,
                "",
                1.0,
                "of each foot's step",
                ("left.sin", "left.cos", "right.sin", "right.cos"),
            ),
        )

    @cached_property
    def size(self) -> int:
        """Number of entries: 4n + 32."""
        return sum(part.size for part in self.parts)

    @cached_property
    def places(self) -> dict[str, slice]:
        """Place of each part, by name; `base` is all between `lag` and `command`."""
        ends = np.cumsum([part.size for part in self.parts]).tolist()
        found = {part.name: slice(end - part.size, end) for part, end in zip(self.parts, ends, strict=True)}
        return found | {"base": slice(found["gyro"].start, found["command"].start)}

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Name of every entry: `position.l_knee`, `gyro.x`."""
        return tuple(f"{part.name}.{label}" for part in self.parts for label in (part.labels or self.joints))

    @cached_property
    def most(self) -> Floats:
        """(size,): no entry is larger than this, nor smaller than its negative."""
        return frozen(np.repeat([part.most for part in self.parts], [part.size for part in self.parts]))


def table(layout: ObservationLayout) -> list[tuple[str, str, str, str]]:
    """Entries, name, unit, meaning: the rows of the page that documents it, with n for the joints."""
    rows = []
    joints = 0
    rest = 0
    for part in layout.parts:
        if not part.labels:
            first = _times(joints)
            last = _times(joints + 1, "-1")
            joints += 1
        else:
            first = f"4n+{rest}"
            last = f"4n+{rest + part.size - 1}"
            rest += part.size
        rows.append((first if first == last else f"{first}..{last}", part.name, part.unit, part.meaning))
    return rows


def _times(count: int, beyond: str = "") -> str:
    return "0" if not count else f"{count if count > 1 else ''}n{beyond}"
