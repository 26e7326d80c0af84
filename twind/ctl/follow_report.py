"""Bounds of FOLLOW_ERR in `twindctl check robot`: per joint the bound, the lag expected, and why it is so."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any

from twind.command_line.text_table import align_columns
from twind.config.robot_spec import JointSpec
from twind.safety.follow_bounds import MARGIN, MOST, FollowBounds, follow_bounds
from twind.safety.guard_types import GuardThresholds
from twind.twin.binding import Binding
from twind.twin.load_survey import worst_load

HEADINGS = ("joint", "follow_rad", "follow_s", "lag", "load N·m", "N·m/rad", "at speed", "bound by")


@dataclass(frozen=True, slots=True)
class FollowRow:
    """Bound of one joint. NaN: unknown."""

    joint: str
    rad: float
    seconds: float
    lag: float  # rad, expected in the worst case
    load: float  # N·m, the largest at rest
    stiffness: float  # N·m/rad
    trail: float  # rad of `lag` that the speed makes
    reason: str
    wanted: float  # rad, a bound with a margin

    @property
    def warning(self) -> str:
        """Warning of a joint that will latch FOLLOW_ERR in use; empty: none."""
        if not self.wanted > MARGIN * self.rad:
            return ""
        return (
            f"warning: {self.joint}: a lag of {self.lag:.2f} rad is expected, follow_rad is {self.rad:g}: "
            f"raise its gain, lower its speed limit, or write follow_rad: {self.wanted:.2f}"
        )

    def fields(self) -> dict[str, Any]:
        """Return the row for `--json`; null: unknown."""
        numbers = {
            "follow_rad": self.rad,
            "follow_s": self.seconds,
            "lag_rad": self.lag,
            "load_nm": self.load,
        }
        known = {key: value if isfinite(value) else None for key, value in numbers.items()}
        return {"joint": self.joint, **known, "reason": self.reason}


def follow_rows(binding: Binding) -> list[FollowRow]:
    """Return the bounds of all joints as the daemon works them out, in the order of the robot file."""
    load = worst_load(binding)
    rated = binding.ratings
    found = follow_bounds(rated, binding.limits, load, GuardThresholds())
    return [
        FollowRow(
            joint.name,
            float(found.rad[place]),
            float(found.seconds[place]),
            float(found.lag[place]),
            float(load[place]),
            float(rated.stiffness[place]),
            float(found.trail[place]),
            _reason(joint, found, place, bodiless=binding.robot.gate.collision.bodiless),
            float(found.wanted[place]),
        )
        for place, joint in enumerate(binding.robot.joints)
    ]


def follow_lines(rows: Sequence[FollowRow]) -> list[str]:
    """Return the table, and a warning for each joint whose bound is too narrow."""
    cells = [
        (
            row.joint,
            f"{row.rad:.3g}",
            f"{row.seconds:g}",
            *(f"{value:.2f}" if isfinite(value) else "?" for value in (row.lag, row.load, row.stiffness)),
            f"{row.trail:.2f}" if isfinite(row.trail) else "?",
            row.reason,
        )
        for row in rows
    ]
    title = f"FOLLOW_ERR: lag expected in rad, and its bound beside {GuardThresholds().lag:g} s of the speed"
    table = align_columns([HEADINGS, *cells], (0, len(HEADINGS) - 1))
    return [title, *table, *(row.warning for row in rows if row.warning)]


def _reason(joint: JointSpec, found: FollowBounds, place: int, *, bodiless: bool) -> str:
    if joint.follow_rad is not None:
        return "robot file"
    if not isfinite(found.trail[place]):
        return f"default: the stall torque or gain of {joint.type.device} is not known"
    if not isfinite(found.wanted[place]):
        why = "the model has no bodies" if bodiless else f"{joint.transmission} shares its actuators"
        return f"default: {why}"
    if found.wanted[place] > MOST:
        return f"largest default; {found.wanted[place]:.2f} is {MARGIN:g} times the lag"
    usual = float(found.rad[place]) <= GuardThresholds().follow
    return "default" if usual else f"{MARGIN:g} times the lag"
