"""Trajectory submission, the front's share of the gate: CMD_EXPIRED to TIME_ORDER. Front process.

All errors are reported at once; an accepted path travels as arrays in a sealed memfd.
"""

import os
import secrets
from collections.abc import Iterator, Mapping
from itertools import islice
from typing import Any

import msgspec
import numpy as np

from twind.exceptions import InvalidInput
from twind.front.joint_naming import JointNames
from twind.link import pack_path
from twind.robot.finding import Finding, ReasonCode
from twind.robot.trajectory import Trajectory
from twind.safety.trajectory_validation import MOST, PointRow, form, unknown_joint
from twind.sealed_memfd import seal

POLICIES = ("reject", "retime")  # strict first
LONGEST_WAIT = 60.0  # s: the largest start_in


class PointMessage(msgspec.Struct, frozen=True):
    """`Point` of the interface: s, and per named joint rad, rad/s, rad/s²."""

    time_from_start: float
    positions: list[float]
    velocities: list[float] | None = None
    accelerations: list[float] | None = None


class ToleranceMessage(msgspec.Struct, frozen=True):
    """`Tolerance` of the interface, rad. None or 0: the default; -1: no check."""

    joint: str
    path: float | None = None
    goal: float | None = None


class TrajectoryMessage(msgspec.Struct, frozen=True):
    """`Trajectory` of the interface. `start_in` and `goal_time` in s."""

    joint_names: list[str]
    points: list[PointMessage]
    start_in: float | None = None
    goal_time: float | None = None
    tolerances: list[ToleranceMessage] | None = None
    policy: str | None = None
    append_stop: bool | None = None


def message_of(given: object) -> TrajectoryMessage:
    """Convert a decoded `Trajectory`. Raises InvalidInput for another shape."""
    try:
        return msgspec.convert(given, TrajectoryMessage)
    except msgspec.ValidationError as error:
        raise InvalidInput(str(error), where="trajectory") from None


def judge(message: TrajectoryMessage, names: JointNames) -> tuple[Trajectory | None, list[Finding]]:
    """Path of a trajectory in joint order, and every finding on its form, start and tolerances."""
    rows = [
        PointRow(point.time_from_start, point.positions, point.velocities, point.accelerations)
        for point in message.points
    ]
    path, findings = form(message.joint_names, rows, names.joints)
    wrong = [*_start(message.start_in), *findings, *islice(_tolerances(message, names), MOST)]
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


def _tolerances(message: TrajectoryMessage, names: JointNames) -> Iterator[Finding]:
    """Tolerances name joints of the robot, once each: positive, 0 for the default or -1 for no check."""
    if message.goal_time is not None and not message.goal_time >= 0.0:
        reason = "goal_time (s) must not be negative"
        yield Finding(ReasonCode.BAD_SCHEMA, value=message.goal_time, bound=0.0, message=reason)
    seen = set()
    for tolerance in message.tolerances or ():
        name = tolerance.joint
        place = names.places.get(name)
        if place is None:
            yield unknown_joint(name, names.joints, "tolerance: ")
        elif name in seen:
            yield Finding(ReasonCode.DUP_JOINT, joint=place, message="two tolerances")
        seen.add(name)
        for key, given in (("path", tolerance.path), ("goal", tolerance.goal)):
            if given is not None and not (given >= 0.0 or given == -1.0):
                reason = f"{key} tolerance (rad) must be positive, 0 for the default or -1 for no check"
                yield Finding(ReasonCode.BAD_SCHEMA, place, value=given, bound=0.0, message=reason)


def policy(message: TrajectoryMessage, description: Mapping[str, object]) -> str:
    """Policy for a path that is too fast: the requested one, else the robot file's.

    Raises InvalidInput for an unknown policy, and for one that is less strict than what the robot file says.
    Where it says nothing, a request may choose.
    """
    gate = description.get("gate")
    settings = gate if isinstance(gate, Mapping) else {}
    theirs = str(settings.get("on_velocity", POLICIES[0]))
    asked = message.policy
    if asked is None:
        return theirs
    if asked not in POLICIES:
        raise InvalidInput(f"expected one of {', '.join(POLICIES)}, got {asked!r}", where="trajectory.policy")
    looser = theirs in POLICIES and POLICIES.index(asked) > POLICIES.index(theirs)
    if looser and not settings.get("request_may_retime"):
        reason = (
            f"the robot file says `gate: {{on_velocity: {theirs}}}`, and a request may only be stricter; "
            f"write `gate: {{on_velocity: {asked}}}` there to allow it"
        )
        raise InvalidInput(reason, where="trajectory.policy")
    return asked


def fields(message: TrajectoryMessage, path: Trajectory, names: JointNames) -> dict[str, Any]:
    """The fields of `link.Submit` that say what was asked."""
    tolerances = [
        (names.places[tolerance.joint], tolerance.path, tolerance.goal)
        for tolerance in message.tolerances or ()
    ]
    return {
        "id": secrets.token_hex(4),  # distinct from those of an earlier front
        "points": int(path.time.size),
        "commanded": np.flatnonzero(path.commanded).tolist(),
        "velocity": path.velocity is not None,
        "acceleration": path.acceleration is not None,
        "start_in": message.start_in or 0.0,
        "goal_time": message.goal_time,
        "tolerances": tolerances,
        "append_stop": bool(message.append_stop),
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
