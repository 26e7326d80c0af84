"""Endstops of a joint and its homing: keys `stop_rad` and `homing`, checked.

A stop is where the mechanism ends, known from its drawing. It lies outside of the limits that the gate keeps.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Literal

from msgspec import Meta

from twind.config.config_reader import ConfigReader, ConfigStruct


@dataclass(frozen=True, slots=True)
class JointEndstops:
    """Joint angles (rad) at which the mechanism ends; None: not described."""

    lower: float | None = None
    """≤ the lower limit | | angle of the mechanical endstop, from the drawing"""
    upper: float | None = None
    """≥ the upper limit | | likewise"""

    def endstop_of_side(self, side: str) -> float | None:
        """The one of that side: `lower` or `upper`."""
        return self.lower if side == "lower" else self.upper

    @property
    def endstops_by_side(self) -> Mapping[str, float]:
        """Those that are, by side."""
        found = {"lower": self.lower, "upper": self.upper}
        return {side: angle for side, angle in found.items() if angle is not None}


@dataclass(frozen=True, slots=True)
class HomingSettings:
    """Defaults of `twindctl calibrate endstop` where the command line gives no value."""

    side: str  # lower or upper
    current_a: float | None = None  # most current on the way; None: the usual share of the limit
    speed: float | None = None  # rad/s of the joint; None: the usual


class HomingKeys(ConfigStruct, kw_only=True):
    """Section `homing` of a joint."""

    method: Literal["endstop"] = "endstop"
    side: Literal["lower", "upper"]
    """which endstop; needs its `stop_rad`"""
    current_a: Annotated[float, Meta(gt=0.0, le=100.0)] | None = None
    """| 12 % of `current_limit_a` | maximum current; accepted: 3–15 %"""
    speed_rad_s: Annotated[float, Meta(gt=0.0, le=1.0)] | None = None
    """| 0.2 | accepted: 0.02–0.5"""


def require_stops(entry: ConfigReader, stops: JointEndstops, lower: float, upper: float) -> None:
    """Raises ConfigError for a `stop_rad` inside of the limits `lower`, `upper` (rad), or far beyond."""
    if entry.has("stop_rad") and not stops.endstops_by_side:
        raise entry.refuse("stop_rad", "names no stop: give lower, upper or both")
    for side, bound, way in (("lower", lower, -1.0), ("upper", upper, 1.0)):
        stop = stops.endstop_of_side(side)
        if stop is None:
            continue
        if not (stop - bound) * way >= 0.0:
            where = f"{stop:g} rad lies inside the limits, which end at {bound:g}"
            message = f"{where}: a stop is where the mechanism ends, outside of them"
            raise entry.section("stop_rad").refuse(side, message)
        if not abs(stop - bound) <= math.pi:
            where = f"{stop:g} rad is more than half a turn from the limit {bound:g}"
            raise entry.section("stop_rad").refuse(side, f"{where}: degrees by mistake?")


def homing(entry: ConfigReader, given: HomingKeys | None, stops: JointEndstops) -> HomingSettings | None:
    """`homing` of a joint with these stops; None: not given. Raises ConfigError."""
    if given is None:
        return None
    if stops.endstop_of_side(given.side) is None:
        message = f"stop_rad of this joint has no {given.side}: it is not known where that stop is"
        raise entry.section("homing").refuse("side", message)
    return HomingSettings(given.side, given.current_a, given.speed_rad_s)
