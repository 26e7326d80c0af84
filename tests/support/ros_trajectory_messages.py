"""JointTrajectory messages of ROS, as encoded bytes."""

from typing import Any

from twind.ros import JOINT_TRAJECTORY, encode, stamp
from twind.ros.joint_state_message import SECOND

NOW = 1_795_000_000_000_000_000  # ns since 1970


def point(time: float, positions: Any = (0.5,), **more: Any) -> dict[str, Any]:
    return {"positions": list(positions), "time_from_start": stamp(round(time * SECOND)), **more}


def command(*points: dict[str, Any], when: int = 0, joints: Any = ("l_knee",), frame: str = "") -> bytes:
    message = {"header": {"stamp": stamp(when), "frame_id": frame}, "joint_names": list(joints)}
    return encode(JOINT_TRAJECTORY, message | {"points": list(points)})
