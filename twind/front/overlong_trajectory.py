"""Early recognition of a trajectory with too many points: before strict JSON, which takes 0.2 s of 3 MB.

Front process. A message that is not certainly too long, or no JSON, is left to the strict parser.
"""

from dataclasses import dataclass
from typing import Any

import msgspec

from twind.safety.gate_types import GateThresholds

MOST = GateThresholds().max_points
METHODS = ("Check", "SubmitTrajectory")
_KEY = b'"time_from_start"'  # each point has this key once; in a string its quotes would be escaped


@dataclass(frozen=True, slots=True)
class OverlongTrajectory:
    """Joint names and number of points of a trajectory with more than `MOST` points."""

    joint_names: list[str]
    points: int


class _Trajectory(msgspec.Struct):
    joint_names: list[str]
    points: list[msgspec.Raw]  # checked as JSON, and not converted


class _Parameters(msgspec.Struct):
    trajectory: _Trajectory


class _Call(msgspec.Struct):
    method: str
    parameters: _Parameters
    more: bool | None = None
    oneway: bool | None = None
    upgrade: bool | None = None


def overlong(data: bytes) -> tuple[dict[str, Any], OverlongTrajectory] | None:
    """Return a call without its parameters, and its trajectory; None: the call has no overlong one."""
    if data.count(_KEY) <= MOST:
        return None
    try:
        call = msgspec.json.decode(data, type=_Call)
    except (msgspec.DecodeError, UnicodeDecodeError):
        return None
    found = OverlongTrajectory(call.parameters.trajectory.joint_names, len(call.parameters.trajectory.points))
    if found.points <= MOST or call.method.rpartition(".")[2] not in METHODS:
        return None
    message = {"method": call.method, "more": call.more, "oneway": call.oneway, "upgrade": call.upgrade}
    return message, found
