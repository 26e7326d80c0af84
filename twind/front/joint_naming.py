"""Joint names for the loop's indices, and sentences for the numbers of findings. Front process."""

from collections.abc import Mapping, Sequence
from math import isfinite, isnan
from typing import Any

from twind.robot.finding import Finding, ReasonCode

# What `value` and `bound` of a finding are, and their unit; codes that are not here carry their own words.
QUANTITIES: Mapping[str, tuple[str, str]] = {
    ReasonCode.POS_LIMIT: ("position", "rad"),
    ReasonCode.OUT_OF_LIMIT: ("position", "rad"),
    ReasonCode.START_JUMP: ("distance from where the motion starts", "rad"),
    ReasonCode.VEL_LIMIT: ("velocity", "rad/s"),
    ReasonCode.ACC_LIMIT: ("acceleration", "rad/s²"),
    ReasonCode.JERK_LIMIT: ("jerk", "rad/s³"),
    ReasonCode.BRAKE_DISTANCE: ("speed towards the limit", "rad/s"),
    ReasonCode.END_NOT_AT_REST: ("velocity at the end", "rad/s"),
    ReasonCode.PATH_TOLERANCE: ("distance from the path", "rad"),
    ReasonCode.GOAL_TOLERANCE: ("distance from the goal", "rad"),
    ReasonCode.STEP_LIMIT: ("step", "rad"),
    ReasonCode.SELF_COLLISION: ("clearance", "m"),
    ReasonCode.KEEP_OUT: ("clearance", "m"),
    ReasonCode.FLOOR: ("clearance", "m"),
    ReasonCode.LEAD_LIMIT: ("lead", "rad"),
    ReasonCode.RETIMED: ("factor", ""),
    ReasonCode.LOOKAHEAD_COLLISION: ("clearance", "m"),
}
# Codes whose message states value and bound beside their subject.
NUMBERS_IN_MESSAGE = frozenset(
    {ReasonCode.BUS_ERRORS, ReasonCode.RX_SHAPE, ReasonCode.FOREIGN_TRAFFIC, ReasonCode.TX_BACKLOG}
)

Plain = dict[str, Any]  # what goes into JSON


class JointNames:
    """The joints' names in their order, as a robot's briefing gives them."""

    def __init__(self, names: Sequence[str]) -> None:
        self.joints = tuple(names)
        self.places = {name: place for place, name in enumerate(self.joints)}

    def finding(self, finding: Finding | Mapping[str, Any]) -> Plain:
        """A finding as the interface spells it: joint by name, message readable on its own."""
        if isinstance(finding, Finding):
            code = finding.code.value
            joint = finding.joint
            point = finding.point
            time = finding.time
            value = finding.value
            bound = finding.bound
            message = finding.message
        else:
            fields = ("joint", "point", "time", "value", "bound")
            joint, point, time, value, bound = (finding.get(key) for key in fields)
            code = str(finding.get("code"))
            message = finding.get("message") or ""
        name = self.name(joint)
        return {
            "code": code,
            "joint": name,
            "point": point,
            "time": time,
            "value": value,
            "bound": bound,
            "message": describe_finding(code, name, point, time, value, bound, message),
        }

    def findings(self, findings: Sequence[Finding | Mapping[str, Any]]) -> list[Plain]:
        """Several."""
        return [self.finding(finding) for finding in findings]

    def name(self, joint: int | None) -> str | None:
        """Name of the joint at a place; None stays None."""
        if joint is None:
            return None
        return self.joints[joint] if 0 <= joint < len(self.joints) else f"joint {joint}"

    def reply(self, parameters: Mapping[str, Any]) -> Plain:
        """The parameters of a loop's reply with every joint named."""
        named = dict(parameters)
        for key in ("findings", "changes", "warnings"):
            if isinstance(named.get(key), list):
                named[key] = self.findings(named[key])
        if isinstance(named.get("verdict"), dict):
            named["verdict"] = self.verdict(named["verdict"])
        joints = named.get("joints")
        if isinstance(joints, list):
            named["joints"] = [self.name(joint) for joint in joints]
        return named

    def verdict(self, verdict: Mapping[str, Any]) -> Plain:
        """Refusals, warnings and changes with every joint named."""
        return {key: self.findings(verdict.get(key) or ()) for key in ("refusals", "warnings", "changes")}


def describe_finding(
    code: str,
    joint: str | None,
    point: int | None,
    time: float | None,
    value: float | None,
    bound: float | None,
    message: str,
) -> str:
    """Format `l_knee, point 3 (0.40 s): position 2.9 rad, bound 2.5 rad; <message>`."""
    where = [] if joint is None else [joint]
    if point is not None:
        where.append(f"point {point}" + ("" if time is None else f" ({time:.3g} s)"))
    elif time is not None:
        where.append(f"at {time:.3g} s")
    numbers = "" if code in NUMBERS_IN_MESSAGE else _numbers(code, value, bound)
    text = "; ".join(part for part in (numbers, message) if part) or code
    return f"{', '.join(where)}: {text}" if where else text


def _numbers(code: str, value: float | None, bound: float | None) -> str:
    what, unit = QUANTITIES.get(code, ("value", ""))
    if value is not None and isnan(value):
        return f"{what} unknown"
    parts = [(what, value), ("bound", bound)]
    return ", ".join(
        f"{name} {_number(number)} {unit}".rstrip() for name, number in parts if number is not None
    )


def _number(value: float) -> str:
    return f"{value:.5g}" if isfinite(value) else str(value)
