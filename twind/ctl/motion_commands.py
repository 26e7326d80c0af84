"""`twindctl move` and `play`: take the lease, stream the result, give the lease back."""

import argparse
import contextlib
import json
import os
import signal
import sys
from collections.abc import Iterator, Mapping, Sequence
from math import isfinite
from pathlib import Path
from threading import Event
from types import FrameType
from typing import Any

from twind.client import Client, ClientError, Disconnected
from twind.client.errors import finding_lines
from twind.client.move_duration import present_goals, slow_duration
from twind.command_line.progress import ProgressLine
from twind.command_line.text_table import fixed_number
from twind.command_line.trajectory_files import load_motion, read_trajectory
from twind.command_line.verb import (
    DONE,
    INTERRUPTED,
    REFUSED,
    FunctionVerb,
    UsageError,
    lease,
    operator,
    remote_robot,
    show,
)
from twind.robot.finding import ReasonCode
from twind.robot.modes import Mode
from twind.robot.recovery_steps import reported_torque
from twind.robot_client.require_armed import stopped_text
from twind_drivers.clock import MonotonicClock

SHOWN = 6  # joints in one line
CUT = 0.5  # s within which `estop --cut` has switched torque off
PAUSE = 0.05  # s between two questions
# why a motion takes longer than its path; other codes are shown alone
CAUSES = {
    "LOOKAHEAD_COLLISION": "slowed near other bodies",
    "LEAD_LIMIT": "waited for a joint that stayed behind",
    "OVERTEMP": "slowed for a hot motor",
    "LOOP_LATE": "ticks were missed",
}
# what may still move when the connection ends in a motion
LOST = (
    "if the daemon died, servos with a watchdog stop by it and others drive on to their last goal: "
    "keep clear; then `twindctl status`, and for the cause `journalctl -u twind` or its terminal"
)


def _common(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--take", action="store_true", help="take the lease from its present holder")
    parser.add_argument(
        "--retime", action="store_true", help="let the daemon slow it down to what joints can do"
    )


def _move_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("goals", nargs="+", metavar="JOINT=RAD", help="goal of a joint")
    parser.add_argument("--time", type=float, metavar="S", help="duration (default: by the longest way)")
    _common(parser)


def _move(options: argparse.Namespace) -> int:
    goals = dict(_goal(text) for text in options.goals)
    if len(goals) != len(options.goals):
        raise UsageError("a joint is named twice")
    with operator(options) as client:
        return _run(client, [_way(client, goals, options.time)], options)


def _way(client: Client, goals: Mapping[str, float], duration: float | None = None) -> dict[str, Any]:
    """Return the trajectory from here to `goals`, rad. `duration` None: slow enough for the longest way."""
    if duration is None:
        duration = slow_duration(goals, present_goals(client))
    point = {
        "positions": list(goals.values()),
        "velocities": [0.0] * len(goals),
        "time_from_start": duration,
    }
    return {"joint_names": list(goals), "points": [point]}


def _goal(text: str) -> tuple[str, float]:
    name, equals, number = text.partition("=")
    try:
        value = float(number)
    except ValueError:
        value = float("nan")
    if not name or not equals or not isfinite(value):
        example = f"{name or 'JOINT'}=0.5"
        raise UsageError(f"{text!r}: expected JOINT=RAD, a joint and its goal in radians, as {example}")
    return name, value


def _play_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("motion", metavar="FILE|NAME", help="a trajectory file, or a motion of the robot")
    parser.add_argument("--approach", action="store_true", help="first move slowly to its first point")
    _common(parser)


def _play(options: argparse.Namespace) -> int:
    with operator(options) as client:
        motion = asked_motion(client, options.motion, options)
        goals = _first_point(motion) if options.approach else {}
        return _run(client, [*([_way(client, goals)] if goals else []), motion], options)


def _first_point(motion: Mapping[str, Any]) -> dict[str, float]:
    """Return the positions of the first point, rad by joint; none where the motion will be refused."""
    names = motion.get("joint_names") or ()
    first = motion["points"][0] if motion["points"] else {}
    return dict(zip(names, first.get("positions") or (), strict=False))


def asked_motion(client: Client, name: str, options: argparse.Namespace) -> dict[str, Any]:
    """Return the motion of the given file or name. Raises UsageError, Rejected.

    A name refers to the folder of the daemon's robot. With --remote that folder is on another disk, where the
    same name may be another motion than here; so a name is refused.
    """
    if remote_robot(options) is not None:
        if not (os.sep in name or name.endswith(".json")):
            raise UsageError(f"{name}: with --remote a file, as ./{name}.json; names are of the robot's disk")
        return read_trajectory(Path(name))
    robot = client.call("GetRobot")["robot"]
    folder = robot.get("motions")
    joints = robot.get("joints")
    names = None if joints is None else [joint["name"] for joint in joints]
    return load_motion(name, Path(folder) if isinstance(folder, str) else None, names)


def _run(client: Client, trajectories: Sequence[dict[str, Any]], options: argparse.Namespace) -> int:
    """Follow the trajectories one after the other, as long as they succeed; show the end of the last."""
    done = True
    last: dict[str, Any] = {}
    place = ""
    interrupted = Event()
    with lease(client, take=options.take):
        for trajectory in trajectories:
            asked = {**trajectory, "policy": "retime"} if options.retime else trajectory
            last = _follow(client, asked, options, interrupted)
            done = last.get("phase") == "succeeded" and not interrupted.is_set()
            if not done:
                place = _place_text(client, trajectory.get("joint_names") or ())
                break
    if done and not options.json:
        place = _mirror_text(client)
    code = DONE if done else INTERRUPTED if interrupted.is_set() else REFUSED
    if options.json:
        return code
    for line in finding_lines(last.get("findings") or (), str(last.get("phase"))):
        print(line, file=sys.stderr)
    show(options, last, f"{last.get('phase')} at {last.get('progress', 0.0):.0%}{longer_text(last)}{place}")
    return code


def _place_text(client: Client, joints: Sequence[str]) -> str:
    """Return where these joints are now, and the steps of a stopped robot; empty: they are unknown."""
    answer: Mapping[str, Any] = {}
    with contextlib.suppress(ClientError):
        answer = _status_after_stop(client)
    at = {row["name"]: row["position"] for row in answer.get("joints") or ()}
    known = [f"{name} {fixed_number(at[name], 3, '')}" for name in joints if at.get(name) is not None]
    rest = ", ..." if len(known) > SHOWN else ""
    place = f"; now at {', '.join(known[:SHOWN])}{rest} rad" if known else ""
    stop = stopped_text(answer["status"]) if answer.get("status") else ""
    return place + (f"\n{stop}" if stop else "")


def _mirror_text(client: Client) -> str:
    """Return that no actuator moved, in mode mirror."""
    with contextlib.suppress(ClientError):
        if client.call("GetStatus").get("status", {}).get("mode") == Mode.MIRROR:
            return "; in the simulation alone: mode mirror moves no actuator"
    return ""


def _status_after_stop(client: Client) -> Mapping[str, Any]:
    """Return the status with joints; after an e-stop not before torque is off, for `CUT` s at most."""
    clock = MonotonicClock()
    deadline = clock.now() + CUT
    while True:
        answer: Mapping[str, Any] = client.call("GetStatus", joints=True)
        status = answer.get("status") or {}
        stopped = ReasonCode.ESTOP in (status.get("latched") or ())
        if not stopped or not reported_torque(status) or clock.now() >= deadline:
            return answer
        clock.sleep_until(clock.now() + PAUSE)


def longer_text(last: dict[str, Any]) -> str:
    """Format by how much and why a motion took longer than its path: empty below a tenth of a second."""
    planned = last.get("duration") or 0.0
    stretch = last.get("stretch") or 0.0
    if f"{planned + stretch:.1f}" == f"{planned:.1f}":
        return ""
    codes = last.get("stretched_by") or ()
    reasons = ", ".join(f"{CAUSES[code]} ({code})" if code in CAUSES else code for code in codes)
    if last.get("phase") == "succeeded":
        return f"; took {planned + stretch:.1f} s instead of {planned:.1f} s: {reasons}"
    return f"; {stretch:.1f} s late: {reasons}"


def _follow(
    client: Client, trajectory: dict[str, Any], options: argparse.Namespace, interrupted: Event
) -> dict[str, Any]:
    """The last report. Ctrl-C cancels, and the robot holds; a second one hangs up, which holds as well."""
    last: dict[str, Any] = {}
    client.timeout = 130.0  # a start may lie 60 s ahead, and nothing is reported until then
    with _interruptible(options, interrupted), ProgressLine(options, options.verb) as progress:
        try:
            for report in client.stream("SubmitTrajectory", trajectory=trajectory):
                last = report
                _report(report, options, progress)
        except Disconnected as error:
            raise Disconnected(f"{error}\n{LOST}") from None
    return last


@contextlib.contextmanager
def _interruptible(options: argparse.Namespace, interrupted: Event) -> Iterator[None]:
    """The first Ctrl-C asks the loop to hold, on a connection of its own, and lets the reports end."""

    def cancel(_number: int, _frame: FrameType | None) -> None:
        interrupted.set()
        signal.signal(signal.SIGINT, signal.default_int_handler)
        print("\ncancelling: the robot holds", file=sys.stderr)
        with operator(options) as other:
            other.timeout = 5.0
            other.call("Cancel")

    before = signal.signal(signal.SIGINT, cancel)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _report(report: dict[str, Any], options: argparse.Namespace, progress: ProgressLine) -> None:
    if options.json:
        print(json.dumps(report, ensure_ascii=False), flush=True)
        return
    verdict = report.get("verdict") or {}
    for key, mark in (("warnings", "warning"), ("changes", "changed")):
        for line in finding_lines(verdict.get(key) or (), mark):
            progress.clear()
            print(line, file=sys.stderr)
    progress.update(report["phase"], report["progress"])


MOVE = FunctionVerb("drive", "Move joints: JOINT=RAD ...", _move_arguments, _move, supports_remote=True)
PLAY = FunctionVerb(
    "drive",
    "Play a trajectory file, or a motion of the robot by name.",
    _play_arguments,
    _play,
    supports_remote=True,
)
