"""Where a joint meets its stops, and how it may be driven against one: `stop_rad`, `homing`. Checked.

A stop is where the mechanism ends, known from its drawing. It lies outside of the limits that the gate keeps.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from twind.config.config_section import ConfigSection

SIDES = ("lower", "upper")


@dataclass(frozen=True, slots=True)
class JointEndstops:
    """Joint angles (rad) at which the mechanism ends; None: not described."""

    lower: float | None = None
    upper: float | None = None

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
    """How `twindctl calibrate endstop` goes about it where the command line does not say."""

    side: str  # lower or upper
    current_a: float | None = None  # most current on the way; None: the usual share of the limit
    speed: float | None = None  # rad/s of the joint; None: the usual


def stops(entry: ConfigSection, lower: float, upper: float) -> JointEndstops:
    """`stop_rad` of a joint with limits `lower`, `upper` (rad). Raises ConfigError: inside the limits."""
    degrees = "stop_deg" in tuple(entry)
    section = entry.section("stop_rad")
    unit = math.radians(1.0) if degrees else 1.0
    found = {side: section.number(side) * unit for side in SIDES if section.has(side)}
    section.close(also=SIDES)
    if entry.has("stop_rad") and not found:
        raise entry.refuse("stop_rad", "names no stop: give lower, upper or both")
    for side, bound, way in (("lower", lower, -1.0), ("upper", upper, 1.0)):
        if side in found and not (found[side] - bound) * way >= 0.0:
            where = f"{found[side]:g} rad lies inside the limits, which end at {bound:g}"
            raise section.refuse(side, f"{where}: a stop is where the mechanism ends, outside of them")
        if side in found and not abs(found[side] - bound) <= math.pi:
            where = f"{found[side]:g} rad is more than half a turn from the limit {bound:g}"
            raise section.refuse(side, f"{where}: degrees by mistake?")
    return JointEndstops(found.get("lower"), found.get("upper"))


def homing(entry: ConfigSection, described: JointEndstops) -> HomingSettings | None:
    """`homing` of a joint whose stops are `described`; None: not given. Raises ConfigError."""
    if not entry.has("homing"):
        return None
    section = entry.section("homing")
    section.text("method", "endstop", ("endstop",))
    side = section.text("side", None, SIDES)
    if described.endstop_of_side(side) is None:
        raise section.refuse("side", f"stop_rad of this joint has no {side}: nobody knows where that stop is")
    current = section.number("current_a", 0.0, above=0.0, most=100.0) if section.has("current_a") else None
    speed = section.number("speed_rad_s", 0.0, above=0.0, most=1.0) if section.has("speed_rad_s") else None
    section.close(also=("current_a", "speed_rad_s"))
    return HomingSettings(side, current, speed)
