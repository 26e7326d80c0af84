"""Subject: settings, robot file, model and calibration, also as the running daemon has read them."""

import hashlib
from collections.abc import Iterator
from math import isfinite
from pathlib import Path
from typing import Any

from twind.config.config_files import new_calibration
from twind.config.doc_pages import CALIBRATION, page
from twind.config.file_changes import fingerprint
from twind.config.robot_file import RobotFile
from twind.doctor.check import Check, CheckNotApplicable, DoctorFinding, Severity
from twind.doctor.check_context import CheckContext, Inspection
from twind.exceptions import InvalidInput, OperationFailed
from twind.twin.binding import bind

SHOWN = 4  # names in one finding

ROWS = (
    Check(
        "FILE_REFUSED",
        "settings, robot file, model or calibration are not usable",
        "the daemon does not start, or refuses the file",
        "correct the place in the message; or restore this robot's calibration",
        Severity.FAULT,
        caution="wrong zeros or limits move the robot to wrong positions: compare with the monitor in mirror "
        "before arming",
        explains=("UNIT_FAILED", "NO_DAEMON"),
    ),
    Check(
        "MODEL_NO_LIMITS",
        "joints of the model have no range",
        "only the robot file limits motion; an error there stays unnoticed",
        'write `range="LOWER UPPER"` at these joints',
        Severity.WARNING,
        caution="torque off, move the joint by hand over the range: a range too wide hits the endstop",
    ),
    Check(
        "WATCHDOG_NONE",
        "devices have no watchdog",
        "if the daemon dies, they drive on to their last goal and hold it",
        "keep a switch that removes the motors' power within reach; run the daemon as a service",
        Severity.NOTE,
    ),
    Check(
        "CALIBRATION_MISSING",
        "this robot has no calibration",
        "zeros are unknown: `live` is refused, `mirror` shows an estimate",
        "see calibration/README.md; another file: `--calibration FILE`",
        Severity.WARNING,
    ),
)


def check_files(context: CheckContext) -> Iterator[DoctorFinding]:
    """FILE_REFUSED: the daemon's error about each file, with line and column."""
    for error in context.wrong_files:
        place = f"{error.file}:{error.line}:{error.column}" if error.line else error.file
        text = f"{error.path}: {error.message}" if error.path else error.message
        advice = "correct it there"
        if error.absent:
            advice = f"name an existing file; a relative path starts at {Path.cwd()}"
        if context.settings is not None and _is_calibration(context, error.file):
            anew = new_calibration(Path(error.file), context.settings, absent=error.absent)
            advice = f"restore this robot's file (`individual:` of the settings names it); {anew}"
        # A file that is not there has no wrong zeros or limits.
        caution = "" if error.absent else None
        yield DoctorFinding("FILE_REFUSED", place, text, advice=advice, caution=caution)


def check_model(context: CheckContext) -> Iterator[DoctorFinding]:
    """FILE_REFUSED: the model does not match the robot file. MODEL_NO_LIMITS: a joint has no range."""
    robot = context.need_robot()
    try:
        bound = bind(robot, context.calibration)
    except InvalidInput as error:
        text = str(error).removeprefix(f"{robot.path}: ")
        advice = "correct the robot file or the model: `twindctl check robot FILE`"
        yield DoctorFinding("FILE_REFUSED", str(robot.path), text, advice=advice)
        return
    free = _without_range(robot, bound.model)
    if free:
        text = f"{len(free)} of {len(robot.joints)} driven joints have no range: {_some(free)}"
        yield DoctorFinding(
            "MODEL_NO_LIMITS", str(robot.mjcf_path), text, "a range at each", advice=_ranges(robot, free)
        )


def check_watchdogs(context: CheckContext) -> Iterator[DoctorFinding]:
    """WATCHDOG_NONE: joints whose devices have no watchdog, by the robot file."""
    joints = [joint for joint in context.need_robot().joints if isfinite(joint.type.lead_limit_rad)]
    if joints:
        text = f"{len(joints)} joints: {_some([joint.name for joint in joints])}"
        yield DoctorFinding("WATCHDOG_NONE", context.need_robot().name, text)


def check_calibration(context: CheckContext) -> Iterator[DoctorFinding]:
    """CALIBRATION_MISSING."""
    robot = context.need_robot()
    if context.settings is None:
        raise OperationFailed("the settings cannot be read")
    if context.sim:
        raise CheckNotApplicable("mode sim needs no calibration")
    if context.daemon is not None:
        there = context.daemon.robot.get("calibration") is not None
    else:
        refused = any(_is_calibration(context, each.file) for each in context.wrong_files)
        there = context.calibration is not None or refused
    if not there:
        yield DoctorFinding(
            "CALIBRATION_MISSING",
            robot.name,
            "no calibration file",
            f"one at {context.settings.usual_calibration(robot.name)}",
            advice=f"see {page(CALIBRATION)}; a file elsewhere is named with `--calibration FILE`",
        )


def check_loaded_files(context: CheckContext) -> Iterator[DoctorFinding]:
    """VERSION_DIFFERS: robot file and calibration of the daemon, against the files of now."""
    daemon = context.need_daemon()
    loaded = daemon.robot
    path = Path(str(loaded["robot"]["path"]))
    if _text_hash(path) not in (loaded["robot"]["text_sha256"], None):
        yield _changed(str(path), "changed since the daemon read it")
    known: Any = loaded.get("calibration")
    here = context.calibration
    if here is None:
        return
    name = f"calibration of {context.need_robot().name}"
    if known is not None and here.sha256 != known["sha256"]:
        yield _changed(name, "changed since the daemon read it")
    if known is None and daemon.status["mode"] != "sim":
        yield _changed(name, "written since the daemon started, which has none")


def _changed(thing: str, text: str) -> DoctorFinding:
    advice = "where that answers `needs a restart`: restart the daemon, disarmed"
    return DoctorFinding("VERSION_DIFFERS", thing, text, command="twindctl reload", advice=advice)


def _is_calibration(context: CheckContext, file: str) -> bool:
    """Return whether this file is the calibration that would be read."""
    if context.settings is None or context.robot is None:
        return False
    name = context.settings.individual or context.robot.name
    usual = context.settings.state_dir / "calibration" / f"{name}.yaml"
    return file in (str(context.settings.calibration), str(usual))


def _without_range(robot: RobotFile, compiled: Any) -> list[str]:
    """List the driven joints that the model does not limit, by their names in the model."""
    return [
        joint.model_joint
        for joint in robot.joints
        if not compiled.jnt_limited[compiled.joint(joint.model_joint).id]
    ]


def _ranges(robot: RobotFile, free: list[str]) -> str:
    joint = next(each for each in robot.joints if each.model_joint == free[0])
    return (
        f'write range="LOWER UPPER" at these joints of {robot.mjcf_path.name}, as the mechanics allow it; '
        f"the robot file has {joint.lower:g}..{joint.upper:g} rad for {joint.name}"
    )


def _text_hash(path: Path) -> str | None:
    """Hash a file as `RobotFile.text_sha256`; None: it cannot be read."""
    try:
        return hashlib.sha256(path.read_text(encoding="utf-8").encode()).hexdigest()
    except (OSError, ValueError):
        return fingerprint(path) or None


def _some(names: list[str]) -> str:
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return ", ".join(names[:SHOWN]) + more


CHECKS = (
    Inspection("files", ("FILE_REFUSED",), check_files),
    Inspection("model", ("FILE_REFUSED", "MODEL_NO_LIMITS"), check_model),
    Inspection("watchdogs", ("WATCHDOG_NONE",), check_watchdogs),
    Inspection("calibration", ("CALIBRATION_MISSING",), check_calibration),
    Inspection("files as read", ("VERSION_DIFFERS",), check_loaded_files),
)
