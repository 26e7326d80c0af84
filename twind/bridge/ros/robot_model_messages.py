"""The robot for ROS: its URDF and its frames, from a process of twind's own interpreter. Library, 3.10.

That process compiles the model, once for each daemon. The bridge needs no MuJoCo: a joint's transform is the
origin that the model gives it, turned about or shifted along its axis.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Mapping, Sequence
from math import cos, sin
from typing import Any

from twind.exceptions import OperationFailed
from twind.ros import STRING, TRANSFORMS, MessageBuffer, encode, stamp

PROCESS = "twind.observe.describing.describe_process"
PATIENCE = 60.0  # s for it; about 0.5 s on an idle machine
SHAPES = 32  # sets of joints whose bytes are kept prepared; a bus that loses answers has many

Quaternion = tuple[float, ...]  # w x y z


class RobotModelMessages:
    """One robot: messages of its URDF and of its transforms."""

    def __init__(self, urdf: str, joints: Sequence[Mapping[str, Any]]) -> None:
        """Take the output of the process."""
        self.urdf = encode(STRING, {"data": urdf})
        self._fixed = [each for each in joints if each["kind"] == "fixed"]
        self._moving = [MovingFrame(each) for each in joints if each["kind"] != "fixed"]
        self.prepared: dict[tuple[str, ...], tuple[list[MovingFrame], MessageBuffer]] = {}

    def fixed(self, time_ns: int) -> bytes:
        """Return the message of /tf_static."""
        rows = [_transform(each) for each in self._fixed]
        for row in rows:
            row["header"]["stamp"] = stamp(time_ns)
        return encode(TRANSFORMS, {"transforms": rows})

    def moving(self, names: Sequence[str], positions: Sequence[float], time_ns: int) -> bytes:
        """Return the message of /tf: the frames whose joints are in `names`, at `positions`."""
        shape = tuple(names)
        if shape not in self.prepared:
            make_room(self.prepared)
            frames = [each for each in self._moving if each.leader in shape]
            rows = [_transform(each.joint) for each in frames]
            self.prepared[shape] = frames, MessageBuffer(TRANSFORMS, {"transforms": rows})
        frames, buffer = self.prepared[shape]
        known = dict(zip(names, positions, strict=True))
        numbers: list[float] = []
        for frame in frames:
            numbers += frame.numbers(known[frame.leader])
        return buffer.fill(time_ns, numbers)


class MovingFrame:
    """Frame of one joint that moves."""

    def __init__(self, joint: Mapping[str, Any]) -> None:
        self.joint = joint
        self.leader: str = joint["leader"]
        self._law = joint["multiplier"], joint["offset"]
        self._turns = joint["kind"] == "revolute"
        self._place: tuple[float, ...] = tuple(joint["position"])
        self._still: Quaternion = tuple(joint["rotation"])
        self._turned = _product(self._still, (0.0, *joint["axis"]))  # half a turn about the axis
        w, x, y, z = self._still
        self._along = _product(self._turned, (w, -x, -y, -z))[1:]  # the axis in the parent

    def numbers(self, leader: float) -> tuple[float, ...]:
        """Return position x y z and rotation x y z w in the parent."""
        multiplier, offset = self._law
        value = multiplier * leader + offset
        if not self._turns:
            w, *rest = self._still
            place = [each + value * along for each, along in zip(self._place, self._along, strict=True)]
            return (*place, *rest, w)
        c = cos(0.5 * value)
        s = sin(0.5 * value)
        w, x, y, z = self._still
        tw, tx, ty, tz = self._turned
        return (*self._place, c * x + s * tx, c * y + s * ty, c * z + s * tz, c * w + s * tw)


def make_room(prepared: dict[Any, Any]) -> None:
    """Remove the oldest of prepared messages that are too many."""
    while len(prepared) >= SHAPES:
        del prepared[next(iter(prepared))]


def describe(interpreter: str, answer: Mapping[str, Any]) -> RobotModelMessages:
    """Return the robot of the answer of `GetRobot`. Raises OperationFailed: its process has failed."""
    request = json.dumps({"robot": answer["robot"], "mjcf": answer["mjcf"]})
    command = [interpreter, "-E", "-P", "-m", PROCESS]  # nothing of a sourced ROS
    try:
        done = subprocess.run(command, input=request, capture_output=True, text=True, timeout=PATIENCE)
    except (OSError, subprocess.SubprocessError) as error:
        raise OperationFailed(f"the robot's URDF: {error}") from None
    if done.returncode:
        reason = (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]
        raise OperationFailed(f"the robot's URDF: {reason}")
    found = json.loads(done.stdout)
    return RobotModelMessages(found["urdf"], found["joints"])


def _transform(joint: Mapping[str, Any]) -> dict[str, Any]:
    """Return the TransformStamped of a joint at position 0."""
    w, x, y, z = joint["rotation"]
    return {
        "header": {"frame_id": joint["parent"]},
        "child_frame_id": joint["child"],
        "transform": {
            "translation": dict(zip("xyz", joint["position"], strict=True)),
            "rotation": {"x": x, "y": y, "z": z, "w": w},
        },
    }


def _product(one: Quaternion, other: Quaternion) -> Quaternion:
    a, b, c, d = one
    w, x, y, z = other
    return (
        a * w - b * x - c * y - d * z,
        a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x,
        a * z + b * y - c * x + d * w,
    )
