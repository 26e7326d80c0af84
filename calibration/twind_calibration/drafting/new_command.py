"""`twindctl robot new`: a folder with a robot file from scans and files of other software."""

import argparse
import shlex
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from twind.command_line.verb import DONE, Rejected, UsageError, show
from twind.config.robot_file import read_robot
from twind.config.robot_spec import RobotFile
from twind.config.yaml_tree import ConfigError
from twind_calibration.drafting.bodiless_model import bodiless_model
from twind_calibration.drafting.mapping_file import fill_from_file, read_mapping
from twind_calibration.drafting.robot_draft import RobotDraft
from twind_calibration.drafting.robot_file_text import (
    DraftedJoint,
    FileAnswers,
    drafted_joints,
    fastest_rate,
    robot_text,
)
from twind_calibration.drafting.robot_steps import SUPPORTS
from twind_calibration.drafting.scan_source import fill_from_scan, scan_port


def write_new(options: argparse.Namespace) -> int:
    """Write the folder and print what is open. Raises Rejected, UsageError: nothing is written."""
    folder = Path(options.folder or options.name)
    if folder.exists():
        raise Rejected(f"{folder} exists: choose another --folder")
    draft, sources = _gather(options)
    conflicts = list(draft.conflicts())
    if conflicts:
        raise Rejected("\n".join(["sources contradict each other:", *conflicts]))
    joints = drafted_joints(draft, _pairs(options.devices, ""))
    support = options.support or _ask_support(options)
    robot = _write(folder, draft, joints, support, no_watchdog=options.no_watchdog)
    result = _report(folder, robot, joints, sources, draft.remarks)
    show(options, result, _text(result))
    return DONE


def _gather(options: argparse.Namespace) -> tuple[RobotDraft, list[str]]:
    draft = RobotDraft(options.name)
    mapping = None if options.mapping is None else read_mapping(Path(options.mapping))
    sources = [f"{file}: {fill_from_file(draft, Path(file), mapping)}" for file in options.files]
    names = _pairs(options.names, None)
    for joint, bus in _pairs(options.buses, None).items():
        if joint not in draft.joints:
            raise UsageError(f"--bus {joint}={bus}: no source has a joint {joint}")
        draft.joints[joint].state("bus", bus, "--bus")
    for bus, port in _pairs(options.ports, "main").items():
        fill_from_scan(draft, bus, port, scan_port(port), names)
        sources.append(f"scan of {bus} at {port}")
    return draft, sources


def _pairs(given: Sequence[str], bare: str | None) -> dict[str, str]:
    """Return NAME=VALUE arguments; a VALUE alone goes by the name `bare`. Raises UsageError."""
    pairs: dict[str, str] = {}
    for text in given:
        name, mark, value = text.partition("=")
        if not mark and bare is not None:
            name, value = bare, name
        if not value or (not name and bare != ""):
            raise UsageError(f"{text!r} is not NAME=VALUE")
        if pairs.setdefault(name, value) != value:
            raise UsageError(f"{text!r}: {name or 'the default'} is given twice")
    return pairs


def _ask_support(options: argparse.Namespace) -> str | None:
    if options.json or not sys.stdin.isatty():
        return None
    while True:
        result = input(f"What carries the robot: {', '.join(SUPPORTS)} (empty: decide later)? ").strip()
        if not result or result in SUPPORTS:
            return result or None


def _write(
    folder: Path, draft: RobotDraft, joints: Sequence[DraftedJoint], support: str | None, *, no_watchdog: bool
) -> RobotFile:
    """Write robot file, model and the folder of motions; return the robot as read back.

    Nothing is left behind where the files are refused. Raises Rejected.
    """
    file = folder / f"{draft.name}.yaml"
    folder.mkdir(parents=True)
    try:
        (folder / "motions").mkdir()
        model = folder / f"{draft.name}.xml"
        ranges = {joint.model_joint: (joint.lower - 0.1, joint.upper + 0.1) for joint in joints}
        model.write_text(bodiless_model(draft.name, ranges))
        families = {joint.family.kind: joint.family for joint in joints}

        def text(rate: int) -> str:
            return robot_text(
                draft,
                joints,
                FileAnswers(model.name, "base", support, bodiless=True, no_watchdog=no_watchdog),
                rate,
            )

        file.write_text(text(10))
        rate = fastest_rate(read_robot(file), families)
        file.write_text(text(rate))
        return read_robot(file)
    except (ConfigError, Rejected, OSError) as error:
        for each in (*folder.glob("*.*"), folder / "motions"):
            each.rmdir() if each.is_dir() else each.unlink()
        folder.rmdir()
        raise Rejected(f"what the sources state is refused: {error}") from None


def _report(
    folder: Path,
    robot: RobotFile,
    joints: Sequence[DraftedJoint],
    sources: Sequence[str],
    remarks: Sequence[str],
) -> dict[str, Any]:
    return {
        "robot": str(robot.path),
        "sources": list(sources),
        "joints": {
            joint.name: {"id": joint.id, "bus": joint.bus, "device": joint.device} for joint in joints
        },
        "rate_hz": robot.rate_hz,
        "todo": list(robot.todo),
        "remarks": list(remarks),
    }


def _text(result: Mapping[str, Any]) -> str:
    file = shlex.quote(result["robot"])
    lines = [f"from {each}" for each in result["sources"]]
    lines.append(f"{result['robot']}: {len(result['joints'])} joints, {result['rate_hz']:g} Hz")
    lines += [f"note: {each}" for each in result["remarks"]]
    lines += [f"open: {each}" for each in result["todo"]]
    lines.append(f"next: twindctl check robot {file}")
    lines.append(f"      twind --virtual --mode live --robot {file}")
    lines.append(f"      twindctl robot finish --robot {file}")
    return "\n".join(lines)
