"""Conversion of a ROS JointTrajectory to a trajectory of the daemon. Pure; standard library, Python 3.10.

The gate checks it like any other. This module handles the ROS-only parts: stamps of the wall clock, efforts,
NaN, and sizes that a message of the socket may not have. Stamps follow joint_trajectory_controller: 0 is now,
a future one waits. With a past stamp the points that are over are left out; all over: refused.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import isfinite
from typing import Any

from twind.bridge.commands.leased_motions import refusal
from twind.exceptions import InvalidInput
from twind.ros import JOINT_TRAJECTORY, MessageDefinitions, decode, definition_text
from twind.ros.cdr import CdrReader
from twind.ros.joint_state_message import SECOND

AHEAD = 60.0  # s that a start may lie in the future: the daemon's own bound
LONGEST = 2 << 20  # bytes of a message; 2,000 points of 40 joints with velocities
FRONT = 16 << 10  # bytes within which frame and joint names have to end
FRAME = 256  # characters of a frame that are reported
POINTS = 2000  # limit of the gate; an empty point takes as long to read as a full one
NUMBERS = 150_000  # of all columns: as JSON they have to stay below the socket's 4 MiB
COLUMNS = ("positions", "velocities", "accelerations")
MESSAGE = MessageDefinitions(JOINT_TRAJECTORY, definition_text(JOINT_TRAJECTORY))


@dataclass(frozen=True, slots=True)
class CommandHeader:
    """Header fields of a command, by which its sender recognises it."""

    sec: int = 0
    nanosec: int = 0
    frame: str = ""
    joints: tuple[str, ...] = ()

    @property
    def time_ns(self) -> int:
        """Time of its stamp, ns since 1970; 0: now."""
        return nanoseconds({"sec": self.sec, "nanosec": self.nanosec})


def heading(data: bytes) -> CommandHeader | None:
    """Return the header of a command's bytes; None: not a command. At most FRONT bytes are read.

    It is without joints where their names do not end there.
    """
    return _front(data)[0]


def _front(data: bytes) -> tuple[CommandHeader | None, int]:
    """Return the header, and the byte at which the points begin; 0: not within FRONT."""
    source = CdrReader(data[:FRONT])
    header, names, _ = MESSAGE.fields(JOINT_TRAJECTORY)
    try:
        content = source.field(MESSAGE, header)
    except (struct.error, UnicodeDecodeError):
        return None, 0
    head = CommandHeader(content["stamp"]["sec"], content["stamp"]["nanosec"], content["frame_id"][:FRAME])
    try:
        return replace(head, joints=tuple(source.field(MESSAGE, names))), source.place
    except (struct.error, UnicodeDecodeError):
        return head, 0


def trajectory(data: bytes, now_ns: int) -> dict[str, Any]:
    """Return the `Trajectory` of the interface from CDR bytes submitted at `now_ns` since 1970.

    Raises Refused.
    """
    _bounded(data)
    try:
        message = decode(JOINT_TRAJECTORY, data)
    except (InvalidInput, RecursionError) as error:
        raise refusal("BAD_SCHEMA", f"malformed: {error}") from None
    joints = message["joint_names"]
    points = [_point(place, point, joints) for place, point in enumerate(message["points"])]
    count = sum(len(point.get(key) or ()) for point in points for key in COLUMNS)
    if count > NUMBERS:
        raise refusal("FRAME_TOO_LARGE", f"{count} numbers: must be at most {NUMBERS}; send fewer points")
    start_in, points = _when(nanoseconds(message["header"]["stamp"]), now_ns, points)
    return {"joint_names": joints, "points": points, "start_in": start_in}


def nanoseconds(time: Mapping[str, int]) -> int:
    """Return a decoded Time or Duration (`decode`) in ns."""
    return time["sec"] * SECOND + time["nanosec"]


def _bounded(data: bytes) -> None:
    """Check by the counts in the bytes that decoding costs little. Raises Refused."""
    if len(data) > LONGEST:
        raise refusal("FRAME_TOO_LARGE", f"more than {LONGEST} bytes: send fewer points")
    place = _front(data)[1]
    if not place and len(data) > FRONT:
        why = f"frame and joint names take more than {FRONT} bytes, or are none: shorten them"
        raise refusal("FRAME_TOO_LARGE", why)
    if place:
        source = CdrReader(data)
        source.place = place
        count = _count(source)
        if count > POINTS:
            raise refusal("FRAME_TOO_LARGE", f"{count} points: must be at most {POINTS}")


def _count(source: CdrReader) -> int:
    """Return the number of values that a row declares; 0 where it declares none, which `decode` reports."""
    try:
        (count,) = source.numbers("I", 4, 1)
    except struct.error:
        return 0
    return int(count)


def _point(place: int, point: Mapping[str, Any], joints: Sequence[str]) -> dict[str, Any]:
    """Return a point, time in s. Raises Refused for a non-finite number and for efforts."""
    if point["effort"]:
        raise refusal("BAD_SHAPE", "efforts are not taken: leave them out", point=place)
    content: dict[str, Any] = {"positions": point["positions"]}
    for key in COLUMNS:
        row = point[key]
        for column, value in enumerate(row):
            if not isfinite(value):
                joint = joints[column] if column < len(joints) else None
                text = f"{joint or 'a joint'}, point {place}: {key} is {value}"
                raise refusal("NONFINITE", text, joint=joint, point=place)
        if row:
            content[key] = row
    return content | {"time_from_start": nanoseconds(point["time_from_start"]) / SECOND}


def _when(stamp_ns: int, now_ns: int, points: list[dict[str, Any]]) -> tuple[float, list[dict[str, Any]]]:
    """Return the beginning, s from now, and the points that are still to come. Raises Refused."""
    if stamp_ns == 0:
        return 0.0, points
    ahead = (stamp_ns - now_ns) / SECOND
    if ahead > AHEAD:
        why = f"the stamp is {ahead:.3f} s ahead of the robot's clock: must be at most {AHEAD:g}"
        raise refusal("TOO_DISTANT", f"{why}; stamp 0 means now", value=ahead, bound=AHEAD)
    if ahead >= 0.0 or not points:
        return max(ahead, 0.0), points
    times = [point["time_from_start"] for point in points]
    if any(after <= before for before, after in pairwise(times)) or times[0] < 0.0:
        raise refusal("TIME_ORDER", "times must increase from 0 on")  # else which points are over is unknown
    left = [point | {"time_from_start": time + ahead} for point, time in zip(points, times, strict=True)]
    left = [point for point in left if point["time_from_start"] > 0.0]
    if not left:
        why = f"its end lies {-ahead - times[-1]:.3f} s in the past of the robot's clock"
        raise refusal("CMD_EXPIRED", f"{why}; stamp 0 means now", value=ahead + times[-1], bound=0.0)
    return 0.0, left
