"""Trajectories of the daemon as `trajectory_msgs/msg/JointTrajectory`. Standard library only."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from twind.ros.cdr import encode
from twind.ros.joint_state_message import SECOND, stamp
from twind.ros.message_definitions import JOINT_TRAJECTORY


def accepted_bytes(accepted: Mapping[str, Any], time_ns: int) -> bytes:
    """Return the message of an `Accepted` of the interface, received at `time_ns` since 1970.

    The stamp says when it starts, the frame which one it is.
    """
    path = accepted["trajectory"]
    begins = time_ns + round((path.get("start_in") or 0.0) * SECOND)
    return encode(
        JOINT_TRAJECTORY,
        {
            "header": {"stamp": stamp(begins), "frame_id": accepted["id"]},
            "joint_names": path["joint_names"],
            "points": [
                {
                    "positions": point["positions"],
                    "velocities": point.get("velocities"),
                    "accelerations": point.get("accelerations"),
                    "time_from_start": stamp(round(point["time_from_start"] * SECOND)),
                }
                for point in path["points"]
            ],
        },
    )
