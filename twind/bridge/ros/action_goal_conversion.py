"""Goal of FollowJointTrajectory in the daemon's form, and its outcome in the form of its client.

Pure: a goal is any object with the fields of control_msgs/action/FollowJointTrajectory. Standard library,
3.10.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from twind.bridge.ros.ros_trajectory import COLUMNS as TAKEN
from twind.ros import JOINT_TRAJECTORY, encode

SUCCESSFUL = 0
INVALID_GOAL = -1
INVALID_JOINTS = -2
OLD_STAMP = -3
PATH_TOLERANCE = -4
GOAL_TOLERANCE = -5
CODES = {
    "UNKNOWN_JOINT": INVALID_JOINTS,
    "DUP_JOINT": INVALID_JOINTS,
    "NO_JOINTS": INVALID_JOINTS,
    "CMD_EXPIRED": OLD_STAMP,
    "PATH_TOLERANCE": PATH_TOLERANCE,
    "GOAL_TOLERANCE": GOAL_TOLERANCE,
}

COLUMNS = (*TAKEN, "effort")

GoalReport = Mapping[str, Any]  # of `RosCommands.goal`: phase, findings, message
State = Mapping[str, Any]  # an answer of Monitor, topic `state`


def outcome(last: GoalReport, *, asked: bool) -> tuple[int, str]:
    """Return code and text of a goal's last report. `asked`: its own client cancelled it."""
    findings: Sequence[Mapping[str, Any]] = last.get("findings") or ()
    words = "; ".join(f"{each['code']}: {each['message']}" for each in findings)
    words = words or str(last.get("message") or "")
    if last["phase"] == "succeeded":
        return SUCCESSFUL, words
    if last["phase"] == "cancelled":
        return (SUCCESSFUL, words) if asked else (INVALID_GOAL, words or "cancelled by another")
    if last["phase"] == "replaced":
        return INVALID_GOAL, words or "replaced by a newer command"
    codes = [CODES[each["code"]] for each in findings if each["code"] in CODES]
    return (codes or [INVALID_GOAL])[0], words


def unserved(goal: Any) -> str:
    """Return the names of a goal's fields in use for joints with several axes, which newer types have."""
    multi = getattr(goal, "multi_dof_trajectory", None)
    parts = {
        "multi_dof_trajectory": multi is not None and (multi.joint_names or multi.points),
        "component_path_tolerance": getattr(goal, "component_path_tolerance", ()),
        "component_goal_tolerance": getattr(goal, "component_goal_tolerance", ()),
    }
    return ", ".join(name for name, given in parts.items() if given)


def tolerances(path: Sequence[Any], goal: Sequence[Any]) -> list[dict[str, Any]]:
    """Return the JointTolerances of a goal in the daemon's form: 0 keeps the default, -1 checks nothing."""
    rows: dict[str, dict[str, Any]] = {}
    for key, given in (("path", path), ("goal", goal)):
        for each in given:
            rows.setdefault(each.name, {"joint": each.name})[key] = float(each.position)
    return list(rows.values())


def as_bytes(trajectory: Any) -> bytes:
    """Return the CDR of a JointTrajectory. rclpy leaves up to 12 bytes of junk behind its own, measured."""
    return encode(
        JOINT_TRAJECTORY,
        {
            "header": {"stamp": _time(trajectory.header.stamp), "frame_id": trajectory.header.frame_id},
            "joint_names": list(trajectory.joint_names),
            "points": [
                {key: list(getattr(point, key)) for key in COLUMNS}
                | {"time_from_start": _time(point.time_from_start)}
                for point in trajectory.points
            ],
        },
    )


def _time(time: Any) -> dict[str, int]:
    return {"sec": time.sec, "nanosec": time.nanosec}


def seconds(duration: Any) -> float:
    """Return a builtin_interfaces Duration in s."""
    return float(duration.sec) + float(duration.nanosec) / 1e9


def places(state: State, names: Sequence[str]) -> tuple[list[float], list[float], list[float]] | None:
    """Return desired, actual and difference in rad, of these joints; None: one of them is not known."""
    joints = {joint["name"]: joint for joint in state["joints"]}
    moved = "position" if state.get("mode") == "live" else "simulated"
    rows = [(joints.get(name, {}).get("goal"), joints.get(name, {}).get(moved)) for name in names]
    known = [(float(goal), float(place)) for goal, place in rows if goal is not None and place is not None]
    if len(known) < len(names):
        return None
    return [goal for goal, _ in known], [place for _, place in known], [goal - place for goal, place in known]
