"""`twindctl check robot FILE` and `check trajectory FILE`: what would be refused, and why."""

import argparse
from pathlib import Path

from twind.client.errors import finding_lines
from twind.ctl.motions import load_motion
from twind.ctl.verb import DONE, REFUSED, Rejected, operator, show


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What is checked, and the file."""
    parser.add_argument("what", choices=["robot", "trajectory"])
    parser.add_argument("file", metavar="FILE|NAME")
    parser.add_argument("--rate", type=float, metavar="HZ", help="robot: at this rate instead of its own")


def run(options: argparse.Namespace) -> int:
    """0 when there is nothing to refuse, else 1."""
    return _robot(options) if options.what == "robot" else _trajectory(options)


def _trajectory(options: argparse.Namespace) -> int:
    """By the daemon's own gate, for the robot as it stands now."""
    with operator(options) as client:
        folder = client.call("GetRobot")["robot"].get("motions")
        trajectory = load_motion(options.file, Path(folder) if isinstance(folder, str) else None)
        verdict = client.call("Check", trajectory=trajectory)["verdict"]
    lines = [
        line
        for key, mark in (("refusals", "refused"), ("warnings", "warning"), ("changes", "changed"))
        for line in finding_lines(verdict[key], mark)
    ]
    show(options, verdict, "\n".join([*lines, "refused" if verdict["refusals"] else "accepted"]))
    return REFUSED if verdict["refusals"] else DONE


def _robot(options: argparse.Namespace) -> int:
    """Without a daemon: the file's grammar, its devices, its cycle budget, and its model."""
    # MuJoCo, numpy and YAML: a second that no other verb pays.
    from twind.config.located import ConfigError
    from twind.config.report import check_robot
    from twind.config.robot_file import load_robot
    from twind.twin.binding import BindingError, bind

    try:
        robot = load_robot(options.file)
        report = check_robot(robot, options.rate)
        errors = list(report.errors)
        try:
            bind(robot, None)
        except BindingError as error:
            errors.append(str(error))
    except ConfigError as error:
        raise Rejected(str(error)) from None
    verdict = f"{len(errors)} error{'s' if len(errors) != 1 else ''}" if errors else "ok"
    lines = [*report.lines, *(f"error: {error}" for error in errors), verdict]
    show(options, {"robot": robot.name, "errors": errors, "lines": list(report.lines)}, "\n".join(lines))
    return REFUSED if errors else DONE
