"""Joints at virtual shafts, and external forces (a hand) that move a limp joint.

A servo has no data of its joint or zero; the code that moves a joint by hand has.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

FASTEST = 20.0  # rad/s, of a hand


@dataclass(frozen=True, slots=True)
class Hinge:
    """The joint at a shaft. Places are the bare encoder's: ticks of a servo, rad of a CAN actuator."""

    joint: str
    zero: float  # place at joint angle 0
    scale: float  # places per rad of the joint, signed
    stops: tuple[float, float] = (-math.inf, math.inf)  # rad, where it meets something hard

    def place(self, angle: float) -> float:
        """Return the place of the shaft when the joint is at `angle` (rad)."""
        return self.zero + angle * self.scale

    def ends(self) -> tuple[float, float]:
        """Places of the stops, the smaller one first."""
        low, high = sorted(self.place(stop) for stop in self.stops)
        return low, high


class ShaftGrip:
    """Shafts of one bus that a hand holds. Rows are places in `hinges`; None: a shaft that turns no joint."""

    def __init__(
        self,
        hinges: Sequence[Hinge | None],
        turns: Sequence[float],
        shown: Callable[[int, float], float],
        grip: Callable[[int, float, float], None],
    ) -> None:
        """`turns`: places per turn of the shaft; `shown`: of a row and a count that it shows, the place.

        `grip`: takes a row to a place with so many places per s; NaN: releases it.
        """
        self._hinges = hinges
        self._turns = turns
        self._shown = shown
        self._grip = grip
        self._rows = {hinge.joint: row for row, hinge in enumerate(hinges) if hinge is not None}

    @property
    def joints(self) -> frozenset[str]:
        """Joints on this bus."""
        return frozenset(self._rows)

    def to(self, row: int, count: float, speed: float) -> None:
        """Move the shaft to show `count`; `speed`: rad/s of the joint, or shaft. Raises ValueError."""
        self._go(row, self._shown(row, _finite("to", count)), speed)

    def angle(self, row: int, rad: float, speed: float) -> None:
        """Move the joint to `rad`. Raises ValueError, also for a shaft that turns no joint."""
        hinge = self._hinges[row]
        if hinge is None:
            raise ValueError("hand: this servo turns no joint of a robot file: give `to` in its own counts")
        self._go(row, hinge.place(_finite("rad", rad)), speed)

    def pose(self, angles: Mapping[str, float], speed: float) -> None:
        """Move joints to angles (rad). Raises KeyError for a joint that is not on this bus, ValueError."""
        strange = [name for name in angles if name not in self._rows]
        if strange:
            raise KeyError(f"hand: no joint {strange[0]!r} on this bus; there are {', '.join(self._rows)}")
        for name, rad in angles.items():
            self.angle(self._rows[name], rad, speed)

    def release_shafts(self, rows: Iterable[int] | None = None) -> None:
        """Release these shafts; None: all."""
        for row in range(len(self._hinges)) if rows is None else rows:
            self._grip(row, math.nan, 0.0)

    def _go(self, row: int, place: float, speed: float) -> None:
        if not 0.0 < speed <= FASTEST:
            raise ValueError(f"hand: speed {speed} is outside 0..{FASTEST:g} rad/s")
        hinge = self._hinges[row]
        scale = self._turns[row] / math.tau if hinge is None else abs(hinge.scale)
        self._grip(row, place, speed * scale)


def _finite(what: str, value: object) -> float:
    """Return the number. Raises ValueError if it is not finite."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"hand: {what} is {value!r}; it is a finite number")
    return float(value)


def order(
    hands: ShaftGrip,
    rows: Sequence[int] | None,
    *,
    to: float | None,
    rad: float | None,
    speed: float,
    off: bool,
    pose: Mapping[str, float] | None,
) -> None:
    """Carry out one order `hand`; `rows`: of the id that it names, else None. Raises ValueError, KeyError."""
    wishes = [name for name, given in (("to", to), ("rad", rad), ("pose", pose)) if given is not None]
    if off and not wishes:
        hands.release_shafts(rows)
    elif wishes == ["pose"] and rows is None and not off:
        hands.pose(pose or {}, speed)
    elif rows is not None and wishes in (["to"], ["rad"]) and not off:
        for row in rows:
            if to is not None:
                hands.to(row, to, speed)
            elif rad is not None:
                hands.angle(row, rad, speed)
    else:
        raise ValueError(
            "hand: it is id with one of `to`, `rad`; or `pose` alone; or `off`, with an id or of all"
        )
