"""The pose that makes joints observable: gone to before, left again after, through the gate."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from math import isfinite

from twind.client import Client, Refused
from twind.client.errors import finding_text
from twind.command_line.verb import Rejected, UsageError, lease
from twind.config.robot_spec import RobotFile
from twind_calibration.rejection_hints import unknown_joint
from twind_calibration.wiggling.joint_move import goal_of

# rad/s, and s at least on the way
SPEED = 0.4
QUICKEST = 1.0


def wanted_pose(robot: RobotFile, name: str | None, bends: Sequence[str]) -> dict[str, float]:
    """Goals (rad) by joint: a pose of the robot file, single joints over it. Raises Rejected, UsageError."""
    if name is not None and name not in robot.poses:
        raise Rejected(f"{robot.name} has no pose {name!r}; it has {', '.join(robot.poses)}")
    goals = {} if name is None else dict(robot.poses[name])
    for bend in bends:
        joint, _, angle = bend.partition("=")
        if joint not in robot.names:
            raise unknown_joint(f"--with {bend}: {robot.name}", joint, robot.names)
        try:
            goals[joint] = float(angle)
        except ValueError:
            raise UsageError(f"--with {bend}: it is JOINT=RAD") from None
        if not isfinite(goals[joint]):
            raise UsageError(f"--with {bend}: it is JOINT=RAD")
    return goals


@contextmanager
def posed(client: Client, goals: Mapping[str, float], *, take: bool) -> Iterator[None]:
    """Joints are at these goals (rad) while the body runs, and then where they were. Nothing, where none is.

    What ends the body leaves them. Raises Rejected (the gate does not let them, or it was ended on the way).
    """
    if not goals:
        yield
        return
    before = {name: goal_of(client, name) for name in goals}
    home = {name: goal for name, goal in before.items() if goal is not None}
    if len(home) < len(goals):
        raise Rejected("positions of joints of the pose are unknown: no reading arrived")
    _move(client, home, goals, take=take)
    yield
    _move(client, goals, home, take=take)


def _move(client: Client, start: Mapping[str, float], goals: Mapping[str, float], *, take: bool) -> None:
    farthest = max(abs(goals[name] - start[name]) for name in goals)
    time = max(farthest / SPEED, QUICKEST)
    still = [0.0] * len(goals)
    point = {"positions": list(goals.values()), "velocities": still, "time_from_start": time}
    with lease(client, take=take):
        try:
            *_, last = client.stream(
                "SubmitTrajectory", trajectory={"joint_names": list(goals), "points": [point]}
            )
        except Refused as refusal:
            said = "; ".join(finding_text(each) for each in refusal.findings)
            raise Rejected(f"the gate does not let it take the pose: {said}") from None
    if last["phase"] != "succeeded":
        said = "; ".join(finding_text(each) for each in last.get("findings") or ()) or str(last["phase"])
        raise Rejected(f"the way to the pose was ended: {said}")
