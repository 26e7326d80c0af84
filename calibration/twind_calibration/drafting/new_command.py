"""`twindctl robot new`: a folder with a robot file from scans and files of other software."""

import argparse
import os
import shlex
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from twind.command_line.verb import DONE, Rejected, UsageError, show
from twind.config.bus_config import NAME
from twind.config.robot_file import read_robot
from twind.config.robot_spec import RobotFile
from twind.config.yaml_tree import ConfigError
from twind.exceptions import InvalidInput
from twind.new_file import unwritten
from twind_calibration.drafting.bodiless_model import bodiless_model
from twind_calibration.drafting.mapping_file import fill_from_file, read_mapping
from twind_calibration.drafting.model_source import fill_from_hardware, fill_from_model
from twind_calibration.drafting.robot_draft import RobotDraft
from twind_calibration.drafting.robot_file_text import (
    RATES,
    DraftedJoint,
    FileAnswers,
    drafted_joints,
    fastest_rate,
    robot_text,
)
from twind_calibration.drafting.robot_steps import SUPPORTS
from twind_calibration.drafting.scan_source import announce, fill_from_scan, require_one_bus, scan_port
from twind_calibration.model_import.imported_model import ImportedModel


def write_new(options: argparse.Namespace) -> int:
    """Write the folder and print what is open. Raises Rejected, UsageError: nothing is written."""
    folder = Path(options.folder or options.name).absolute()
    if folder.exists():
        raise Rejected(f"{folder} exists: choose another --folder")
    draft = RobotDraft(options.name)
    sources = _read_sources(options, draft)
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        place = tempfile.TemporaryDirectory(prefix=f".{folder.name}.", dir=folder.parent)
    except OSError as error:
        raise Rejected(f"{folder} cannot be made: {unwritten(error)}") from None
    with place as beside:
        made = Path(beside) / folder.name
        made.mkdir()
        model = None if options.model is None else _import(options, made)
        joints, answers = _complete(options, draft, model)
        robot = _write(made, draft, joints, answers)
        os.rename(made, folder)
    if options.model:
        sources.append(f"{options.model}: model")
    result = {
        "robot": str(folder / robot.path.name),
        "sources": sources,
        "joints": {
            joint.name: {"id": joint.id, "bus": joint.bus, "device": joint.kind.device} for joint in joints
        },
        "rate_hz": robot.rate_hz,
        "todo": list(robot.todo),
        "remarks": draft.remarks,
    }
    show(options, result, _text(result))
    return DONE


def _read_sources(options: argparse.Namespace, draft: RobotDraft) -> list[str]:
    mapping = None if options.mapping is None else read_mapping(Path(options.mapping))
    sources = []
    for given in options.files:
        prefix, file = _split_prefix(given)
        sources.append(f"{given}: {fill_from_file(draft, file, mapping, prefix)}")
    for pattern, bus in _pairs(options.buses, None).items():
        for joint in draft.select(pattern, f"--bus {pattern}={bus}"):
            draft.joints[joint].state("bus", bus, "--bus")
    ports = _pairs(options.ports, "main")
    scans: dict[str, list[dict[str, Any]]] = {}
    for bus, port in ports.items():
        announce(options, port)
        scans[bus] = scan_port(port)
        sources.append(f"scan of {bus} at {port}")
    require_one_bus(draft, scans)
    named = bool(draft.joints)
    for bus, devices in scans.items():
        fill_from_scan(draft, bus, ports[bus], devices, named=named)
    return sources


def _import(options: argparse.Namespace, folder: Path) -> ImportedModel:
    from twind_calibration.model_import.import_model import import_model  # its libraries are an extra

    packages = {name: Path(place) for name, place in _pairs(options.packages, None).items()}
    try:
        return import_model(
            Path(options.model),
            folder,
            floating=True,
            packages=packages,
            arguments=_pairs(options.arguments, None),
        )
    except InvalidInput as error:
        raise Rejected(str(error)) from None


def _complete(
    options: argparse.Namespace, draft: RobotDraft, model: ImportedModel | None
) -> tuple[list[DraftedJoint], FileAnswers]:
    """Return every joint with all that a robot file says of it. Raises Rejected."""
    if model is not None:
        fill_from_hardware(draft, model)
    draft.leave_out(options.without)
    draft.rename(_pairs(options.names, None))
    passive = () if model is None else fill_from_model(draft, model)
    conflicts = list(draft.conflicts())
    if conflicts:
        remedy = "if they describe other parts of the robot, prefix their names: --from left_=FILE"
        raise Rejected("\n".join(["sources contradict each other:", *conflicts, remedy]))
    answers = FileAnswers(
        model=f"{draft.name}.xml" if model is None else model.file.name,
        base="base" if model is None else model.base,
        passive=passive,
        support=options.support or _ask_support(options),
        bodiless=model is None,
        no_watchdog=options.no_watchdog,
    )
    return drafted_joints(draft, _pairs(options.devices, "")), answers


def _split_prefix(text: str) -> tuple[str, Path]:
    """Return prefix and file of `[PREFIX=]FILE`; write `./a=b.json` for a file named so."""
    prefix, mark, file = text.partition("=")
    if not mark or not file or not NAME.fullmatch(prefix):
        return "", Path(text)
    return prefix, Path(file)


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
    folder: Path, draft: RobotDraft, joints: Sequence[DraftedJoint], answers: FileAnswers
) -> RobotFile:
    """Write robot file, folder of motions and, where none was imported, the model; return the robot.

    Raises Rejected: what the sources state makes no robot file.
    """
    (folder / "motions").mkdir()
    if answers.bodiless:
        ranges = {joint.model_joint: (joint.lower - 0.1, joint.upper + 0.1) for joint in joints}
        (folder / answers.model).write_text(bodiless_model(draft.name, ranges))
    file = folder / f"{draft.name}.yaml"
    families = {joint.family.kind: joint.family for joint in joints}
    try:
        file.write_text(robot_text(draft, joints, answers, RATES[-1]))
        rate = fastest_rate(read_robot(file), families)
        file.write_text(robot_text(draft, joints, answers, rate))
        return read_robot(file)
    except ConfigError as error:
        raise Rejected(
            f"what the sources state is refused: {str(error).replace(str(folder), folder.name)}"
        ) from None


def _text(result: Mapping[str, Any]) -> str:
    file = shlex.quote(result["robot"])
    lines = [f"from {each}" for each in result["sources"]]
    lines.append(f"{result['robot']}: {len(result['joints'])} joints, {result['rate_hz']:g} Hz")
    lines += [f"note: {each}" for each in result["remarks"]]
    lines += [f"open: {each}" for each in result["todo"]]
    steps = [f"twindctl check robot {file}"]
    if any(each.endswith(".watchdog") for each in result["todo"]):  # not even a virtual servo is armed
        steps.append(f"twindctl robot finish --no-watchdog --robot {file}")
    else:
        steps.append(f"twind --virtual --mode live --robot {file}   # a trial on virtual servos; then end it")
    finish = f"twindctl robot finish --robot {file}"
    steps.append(f"twind --mode mirror --robot {file} --port [BUS=]PORT   # the robot itself, limp")
    if any(each.endswith(".sign") for each in result["todo"]):
        steps.append(f"{finish}   # then restart the daemon")
    steps += ["twindctl calibrate sweep", "twindctl calibrate zero", finish]
    lines.append(f"next: {steps[0]}")
    lines += [f"      {each}" for each in steps[1:]]
    return "\n".join(lines)
