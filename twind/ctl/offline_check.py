"""Offline check of a trajectory: the daemon's own parts judge it, for a robot that stands still in a pose.

The front's share, the gate, and the checks of collisions, torque and balance run in the order of a `Check`
call. Conditions of one moment only (lease, latches, received messages) are left out.
"""

from collections.abc import Mapping
from typing import Any

import msgspec
import numpy as np

from twind.client.errors import CallError
from twind.command_line.trajectory_files import load_motion, motion_names
from twind.command_line.verb import Rejected, UsageError
from twind.config.robot_file import RobotFile
from twind.exceptions import InvalidInput
from twind.front import trajectory_submission
from twind.front.joint_naming import JointNames
from twind.front.state_cache import encode
from twind.front.trajectory_submission import TrajectoryMessage
from twind.link import Submit
from twind.loop.procedures.trajectory_submissions import of_the_path, plain, with_front
from twind.protocol import CONTROL, SERVICE, load
from twind.robot.arrays import Floats
from twind.robot.finding import Verdict
from twind.robot.modes import Mode, Motion, RobotState
from twind.robot.trajectory import Reference, Trajectory
from twind.safety.gate import GateSnapshot, GateThresholds, TrajectoryRequest, check
from twind.twin.binding import Binding
from twind.twin.dynamics import Dynamics
from twind.twin.simulation import hush
from twind.twin.trajectory_precheck import TrajectoryPrecheck

NARROWER = 1e-3  # rad: a limit that is narrowed by less is the same
NAMED = 5  # limits in a note


def verdict(binding: Binding, position: Floats, trajectory: dict[str, Any]) -> dict[str, Any]:
    """Return the answer of `Check` to `trajectory` for a robot that holds at `position` (n,), rad.

    Raises CallError as the call does.
    """
    names = JointNames(binding.joint_map.names)
    message, policy = _message(trajectory, binding.robot)
    path, wrong = trajectory_submission.judge(message, names)
    if path is None:
        return _as_sent({"refusals": names.findings(wrong), "warnings": [], "changes": []})
    snapshot = standing(position, 1.0 / binding.robot.rate_hz)
    asked = trajectory_submission.fields(message, path, names)
    found = _run_precheck(binding, path, snapshot.reference, append_stop=asked["append_stop"])
    shares: dict[str, Any] = {"policy": policy, "refused": found.refusals, "warned": found.warnings}
    command = Submit(ticket=0, client=0, uid=0, holder="", check_only=True, **asked, **shares)
    demand = TrajectoryRequest(command.policy, command.append_stop, command.start_in)
    judged = check(path, snapshot, binding.limits, demand, GateThresholds())
    return _as_sent(names.verdict(plain(of_the_path(with_front(judged.verdict, command)))))


def calibration_note(
    described: Binding, calibrated: Binding | None, trajectory: Mapping[str, Any] | None = None
) -> str:
    """Return which limits a calibration narrows and by how much, or that none was given.

    Without one it names the joints of `trajectory` that come nearest to limits of the robot file: a shorter
    travel is refused there first.
    """
    names = described.joint_map.names
    if calibrated is None:
        near = "".join(
            f"; {name} comes within {room:.3f} rad of its {side} limit"
            for room, name, side in _rooms(described, trajectory or {})[:NAMED]
        )
        return (
            f"note: --calibration FILE was not given: checked with limits_rad of {described.robot.path}. The "
            "daemon of a calibrated robot narrows them to the measured travel and may refuse what passes "
            f"here{near}"
        )
    lost = [
        (float(by), names[place], side)
        for side, narrowed in (
            ("lower", calibrated.limits.lower - described.limits.lower),
            ("upper", described.limits.upper - calibrated.limits.upper),
        )
        for place, by in enumerate(narrowed.tolist())
        if by >= NARROWER
    ]
    if not lost:
        return "note: the calibration narrows no limit of the robot file"
    lost.sort(reverse=True)
    listed = ", ".join(f"{name} {side} by {by:.3f} rad" for by, name, side in lost[:NAMED])
    more = f" and {len(lost) - NAMED} more" if len(lost) > NAMED else ""
    return f"note: the calibration narrows limits of the robot file: {listed}{more}"


def _rooms(binding: Binding, trajectory: Mapping[str, Any]) -> list[tuple[float, str, str]]:
    """Return distance (rad) to a limit, joint and side of a path inside its limits, the nearest first."""
    found = []
    points = [point.get("positions") or () for point in trajectory.get("points", ())]
    for column, name in enumerate(trajectory.get("joint_names", ())):
        if name not in binding.joint_map.names:
            continue
        place = binding.joint_map.names.index(name)
        path = [row[column] for row in points if len(row) > column and isinstance(row[column], float | int)]
        if path:
            found.append((min(path) - float(binding.limits.lower[place]), name, "lower"))
            found.append((float(binding.limits.upper[place]) - max(path), name, "upper"))
    return sorted(each for each in found if each[0] >= 0.0)


def _run_precheck(binding: Binding, path: Trajectory, before: Reference, *, append_stop: bool) -> Verdict:
    """Run the look-ahead checks SELF_COLLISION to UNSTABLE_POSE on `path` and return their verdict."""
    hush()
    looking = TrajectoryPrecheck(binding, 1.0 / binding.robot.rate_hz, Dynamics(binding))
    steps = looking.judging(path, before, append_stop=append_stop)
    while True:
        try:
            next(steps)
        except StopIteration as stop:
            found: Verdict = stop.value
            return found


def pose(robot: RobotFile, name: str) -> Floats:
    """Return the pose `name` of the robot file (n,), rad. Raises UsageError if there is no such pose."""
    if name not in robot.poses:
        raise UsageError(f"no pose {name!r} in {robot.path}; known: {', '.join(robot.poses)}")
    return np.array([robot.poses[name][joint] for joint in robot.names])


def standing(position: Floats, period: float) -> GateSnapshot:
    """Build the gate's snapshot of a simulated robot that holds at `position` (n,), rad; lease held.

    `period`: of its ticks, s.
    """
    still = np.zeros_like(position)
    return GateSnapshot(
        now=0.0,
        mode=Mode.SIM,
        state=RobotState.DISCONNECTED,
        motion=Motion.HOLDING,
        latched=(),
        lease_held=True,
        mismatches=(),
        calibrated=np.ones(len(position), np.bool_),
        age=still,
        latency=0.0,
        latency_p95=0.0,
        reference=Reference(position, still, still),
        period=period,
    )


def _message(trajectory: dict[str, Any], robot: RobotFile) -> tuple[TrajectoryMessage, str]:
    """Return the trajectory, and the policy that it requests, else the robot file's.

    Raises CallError where the message has another shape.
    """
    try:
        load(CONTROL).methods["Check"].parameters.check({"trajectory": trajectory}, "")
        message = trajectory_submission.message_of(trajectory)
        return message, trajectory_submission.policy(message, msgspec.to_builtins(robot, enc_hook=str))
    except InvalidInput as error:
        parameter = error.where or "parameters"
        raise CallError(
            f"{SERVICE}.InvalidParameter", {"parameter": parameter, "message": error.reason}
        ) from None


def _as_sent(found: dict[str, Any]) -> dict[str, Any]:
    """Convert a result to the form that a client receives: values that are no numbers become null."""
    sent: dict[str, Any] = msgspec.json.decode(encode(found))
    return sent


def motions_of(robot: RobotFile) -> tuple[dict[str, Trajectory], list[str]]:
    """Paths by name, and what is wrong with the files that are none for this robot."""
    names = JointNames(robot.names)
    paths = {}
    wrong = []
    for name in motion_names(robot.motions) if robot.motions.is_dir() else ():
        try:
            message = trajectory_submission.message_of(load_motion(name, robot.motions))
        except (Rejected, InvalidInput) as error:
            wrong.append(f"motion {name}: {error}")
            continue
        path, findings = trajectory_submission.judge(message, names)
        if path is None:
            wrong.append(f"motion {name}: {names.findings(findings)[0]['message']}")
        else:
            paths[name] = path
    return paths, wrong
