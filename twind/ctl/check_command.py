"""Check a robot file, or a trajectory against the gate.

Reports what would be refused, and why. A trajectory is checked by the daemon, or with --robot without one.
"""

import argparse
from pathlib import Path
from typing import Any

from twind.client.errors import finding_lines
from twind.command_line.progress import ProgressLine
from twind.command_line.trajectory_files import load_motion
from twind.command_line.verb import DONE, REFUSED, Rejected, UsageError, operator, remote_robot, show
from twind.ctl.motion_commands import asked_motion
from twind.exceptions import InvalidInput, OperationFailed

group = "set up"
supports_remote = True


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments: the kind of check, the file, and their options."""
    parser.add_argument("what", choices=["robot", "trajectory"], help="kind of file")
    parser.add_argument("file", metavar="FILE|NAME", help="a file, a built-in robot or a motion")
    parser.add_argument("--rate", type=float, metavar="HZ", help="robot: at this rate instead of its own")
    parser.add_argument("--robot", metavar="NAME|FILE", help="trajectory: for this robot, without a daemon")
    parser.add_argument("--pose", metavar="NAME", help="with --robot: the pose it stands in (default: rest)")
    parser.add_argument("--calibration", metavar="FILE", help="with --robot: calibration of this individual")


def run(options: argparse.Namespace) -> int:
    """0 when there is nothing to refuse, else 1."""
    alone = [name for name in ("pose", "calibration") if getattr(options, name) is not None]
    if alone and options.robot is None:
        raise UsageError(f"--{alone[0]} goes with --robot: a daemon knows its robot itself")
    if options.what == "robot":
        if remote_robot(options) is not None:
            raise UsageError("check robot reads a file and asks no robot: leave out --remote")
        if options.robot is not None:
            raise UsageError("check robot takes the robot's name or file itself: leave out --robot")
        return _robot(options)
    if options.robot is not None and remote_robot(options) is not None:
        raise UsageError("--robot and --remote: one robot at a time")
    return _trajectory(options)


def _trajectory(options: argparse.Namespace) -> int:
    """By the daemon's own gate for the robot as it stands now, or without a daemon for one in a pose."""
    verdict, notes = (_make_request(options), []) if options.robot is None else _offline(options)
    lines = [
        line
        for key, mark in (("refusals", "refused"), ("warnings", "warning"), ("changes", "changed"))
        for line in finding_lines(verdict[key], mark)
    ]
    show(options, verdict, "\n".join([*lines, *notes, "refused" if verdict["refusals"] else "accepted"]))
    return REFUSED if verdict["refusals"] else DONE


def _make_request(options: argparse.Namespace) -> dict[str, Any]:
    with operator(options) as client:
        trajectory = asked_motion(client, options.file, options)
        verdict: dict[str, Any] = client.call("Check", trajectory=trajectory)["verdict"]
        # A check moves nothing and needs no lease.
        verdict["warnings"] = [each for each in verdict["warnings"] if each["code"] != "LEASE_MISSING"]
        return verdict


def _offline(options: argparse.Namespace) -> tuple[dict[str, Any], list[str]]:
    """Return the verdict without a daemon, and notes on what it rests on."""
    from twind.config.calibration_file import load_calibration
    from twind.config.robot_file import load_robot
    from twind.config.yaml_tree import ConfigError
    from twind.ctl.offline_check import calibration_note, pose, verdict
    from twind.twin.binding import bind

    try:
        robot = load_robot(options.robot)
        known = None if options.calibration is None else load_calibration(Path(options.calibration), robot)
        position = pose(robot, options.pose or "rest")
        joints = [joint.name for joint in robot.joints]
        binding = bind(robot, known)
        motion = load_motion(options.file, robot.motions, joints)
        found = verdict(binding, position, motion)
        return found, [calibration_note(bind(robot, None), binding if known else None, motion)]
    except (ConfigError, InvalidInput) as error:
        raise Rejected(str(error)) from None


def _robot(options: argparse.Namespace) -> int:
    """Without a daemon: grammar, devices, travel, cycle budget, model, clearances, steps, virtual body."""
    # MuJoCo, numpy and YAML: a second that no other verb pays.
    from twind.config.robot_file import load_robot
    from twind.config.robot_report import check_robot
    from twind.config.yaml_tree import ConfigError
    from twind.ctl.follow_report import FollowRow, follow_lines, follow_rows
    from twind.ctl.offline_check import motions_of
    from twind.twin.binding import bind
    from twind.twin.clearance_survey import survey
    from twind.twin.mujoco_physics import body_of
    from twind.twin.settling_survey import survey_settling

    try:
        with ProgressLine(options, "check") as progress:
            progress.update("the file")
            robot = load_robot(options.file)
            report = check_robot(robot, options.rate)
            errors = list(report.errors)
            said = list(report.lines)
            near = None
            follow: list[FollowRow] = []
            try:
                motions, wrong = motions_of(robot)
                said += [f"warning: {each}" for each in wrong]
                progress.update(f"clearances of {len(robot.poses)} poses and {len(motions)} motions")
                binding = bind(robot, None)
                follow = follow_rows(binding)
                said += follow_lines(follow)
                near = survey(binding, motions)
                progress.update("a step of each joint")
                unsettled = survey_settling(binding)
                said += [f"warning: {each}" for each in unsettled if not each.broken]
                errors += [str(each) for each in unsettled if each.broken]
                progress.update("the virtual body")
                body_of(robot, {joint.name: joint.type.centre for joint in robot.joints})
            except (InvalidInput, OperationFailed) as error:
                errors.append(str(error))
    except ConfigError as error:
        raise Rejected(str(error)) from None
    if near is not None:
        said += near.lines()
        errors += [near.error] if near.error is not None else []
    verdict = f"{len(errors)} error{'s' if len(errors) != 1 else ''}" if errors else "ok"
    lines = [*said, *(f"error: {error}" for error in errors), verdict]
    allow = [] if near is None else [list(pair) for pair in near.proposed]
    rows = [row.fields() for row in follow]
    told = {"robot": robot.name, "errors": errors, "lines": said, "allow": allow, "follow": rows}
    show(options, told, "\n".join(lines))
    return REFUSED if errors else DONE
