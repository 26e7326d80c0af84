"""Trajectory submission, the front's share of the gate: CMD_EXPIRED to TIME_ORDER. Front process.

All errors are reported at once; an accepted path travels as arrays in a sealed memfd.
"""

import os
import secrets
from collections.abc import Mapping
from typing import Any

import numpy as np

from twind.front.joint_naming import JointNames
from twind.link import pack_path
from twind.memfd import seal
from twind.robot.finding import Finding, ReasonCode
from twind.robot.trajectory import Trajectory
from twind.safety.trajectory_validation import PointRow, form

POLICIES = ("reject", "retime")  # strict first
LONGEST_WAIT = 60.0  # s: the largest start_in


class ToleranceTooLoose(ValueError):
    """Request with looser tolerances than the robot file permits. `field` names it."""

    def __init__(self, field: str, reason: str) -> None:
        super().__init__(f"{field}: {reason}")
        self.field = field
        self.reason = reason


def judge(message: Mapping[str, Any], names: JointNames) -> tuple[Trajectory | None, list[Finding]]:
    """Return the path in joint order and its findings, CMD_EXPIRED to TIME_ORDER."""
    rows = [
        PointRow(
            point["time_from_start"], point["positions"], point.get("velocities"), point.get("accelerations")
        )
        for point in message["points"]
    ]
    path, findings = form(message["joint_names"], rows, names.joints)
    wrong = [*_start(message.get("start_in")), *findings, *_tolerances(message, names)]
    return (None if wrong else path), wrong


def _start(start_in: float | None) -> list[Finding]:
    """Check CMD_EXPIRED."""
    if start_in is None or 0.0 <= start_in <= LONGEST_WAIT:
        return []
    if start_in > LONGEST_WAIT:
        reason = "start_in (s) is too far ahead"
        return [Finding(ReasonCode.TOO_DISTANT, value=start_in, bound=LONGEST_WAIT, message=reason)]
    return [
        Finding(ReasonCode.CMD_EXPIRED, value=start_in, bound=0.0, message="start_in (s) lies in the past")
    ]


def _tolerances(message: Mapping[str, Any], names: JointNames) -> list[Finding]:
    """Tolerances name joints of the robot, once each: positive, 0 for the default or -1 for no check."""
    findings = []
    seen = set()
    for tolerance in message.get("tolerances") or ():
        name = tolerance["joint"]
        place = names.places.get(name)
        if place is None:
            findings.append(
                Finding(ReasonCode.UNKNOWN_JOINT, message=f"tolerance of {name!r}: no such joint")
            )
        elif name in seen:
            findings.append(Finding(ReasonCode.DUP_JOINT, joint=place, message="two tolerances"))
        seen.add(name)
        for key in ("path", "goal"):
            given = tolerance.get(key)
            if given is not None and not (given >= 0.0 or given == -1.0):
                reason = f"{key} tolerance (rad) must be positive, 0 for the default or -1 for no check"
                findings.append(Finding(ReasonCode.BAD_SCHEMA, place, value=given, bound=0.0, message=reason))
    if message.get("goal_time") is not None and not message["goal_time"] >= 0.0:
        reason = "goal_time (s) must not be negative"
        findings.append(Finding(ReasonCode.BAD_SCHEMA, value=message["goal_time"], bound=0.0, message=reason))
    return findings


def policy(message: Mapping[str, Any], description: Mapping[str, Any]) -> str:
    """Return the policy for a path that is too fast: the requested one, else the robot file's.

    Raises ToleranceTooLoose for a looser one.
    """
    gate = description.get("gate")
    configured = str(gate.get("on_velocity", POLICIES[0])) if isinstance(gate, Mapping) else POLICIES[0]
    requested = message.get("policy")
    if requested is None:
        return configured
    if requested not in POLICIES:
        raise ToleranceTooLoose(
            "trajectory.policy", f"expected one of {', '.join(POLICIES)}, got {requested!r}"
        )
    if configured in POLICIES and POLICIES.index(requested) > POLICIES.index(configured):
        reason = f"the robot file sets {configured} (gate: on_velocity); a request may only be stricter"
        raise ToleranceTooLoose("trajectory.policy", reason)
    return str(requested)


def fields(message: Mapping[str, Any], path: Trajectory, names: JointNames) -> dict[str, Any]:
    """Return the fields of `link.Submit` with the request."""
    tolerances = [
        (names.places[tolerance["joint"]], tolerance.get("path"), tolerance.get("goal"))
        for tolerance in message.get("tolerances") or ()
    ]
    return {
        "id": secrets.token_hex(4),  # distinct from those of an earlier front
        "points": int(path.time.size),
        "commanded": np.flatnonzero(path.commanded).tolist(),
        "velocity": path.velocity is not None,
        "acceleration": path.acceleration is not None,
        "start_in": message.get("start_in") or 0.0,
        "goal_time": message.get("goal_time"),
        "tolerances": tolerances,
        "append_stop": bool(message.get("append_stop")),
    }


class SealedTrajectory:
    """The arrays of a path in a memfd, for as long as the context lasts."""

    def __init__(self, path: Trajectory) -> None:
        self._data = pack_path(path)
        self.fd = -1

    def __enter__(self) -> int:
        self.fd = seal("twind-path", self._data)
        return self.fd

    def __exit__(self, *_: object) -> None:
        os.close(self.fd)
