"""Checks of settings, robot file, model, calibration; and whether the daemon has read what stands there."""

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from twind.config.doc_pages import CALIBRATION, page
from twind.config.file_changes import fingerprint
from twind.config.robot_file import RobotFile
from twind.exceptions import InvalidInput
from twind.twin.binding import bind
from twind_calibration.doctor.check import CheckNotApplicable, CheckUnavailable, DoctorFinding
from twind_calibration.doctor.check_context import CheckContext

SHOWN = 4  # names in one finding


def check_file_refused(x: CheckContext) -> Iterator[DoctorFinding]:
    """FILE_REFUSED, CALIBRATION_UNFIT: what the daemon would say of each file, with file, line and column."""
    for error in x.wrong_files:
        code = "CALIBRATION_UNFIT" if _of_calibration(x, error.file) else "FILE_REFUSED"
        place = f"{error.file}:{error.line}:{error.column}" if error.line else error.file
        says = f"{error.path}: {error.message}" if error.path else error.message
        yield DoctorFinding(code, place, says, advice=_how_to_mend(code))


def model(x: CheckContext) -> Iterator[DoctorFinding]:
    """MODEL_UNFIT, MODEL_NO_LIMITS: does the model fit the robot file, and has each of its joints a range?"""
    robot = x.need_robot()
    try:
        bound = bind(robot, x.calibration)
    except InvalidInput as error:
        yield DoctorFinding("MODEL_UNFIT", str(robot.path), str(error).removeprefix(f"{robot.path}: "))
        return
    free = _without_range(robot, bound.model)
    if free:
        said = f"{len(free)} of {len(robot.joints)} driven joints have no range: {_some(free)}"
        yield DoctorFinding(
            "MODEL_NO_LIMITS", str(robot.mjcf_path), said, "a range at each", advice=_ranges(robot, free)
        )


def calibration(x: CheckContext) -> Iterator[DoctorFinding]:
    """CALIBRATION_MISSING: no calibration of this robot where it is looked for."""
    robot = x.need_robot()
    if x.settings is None:
        raise CheckUnavailable("the settings cannot be read")
    if x.sim:
        raise CheckNotApplicable("mode sim needs no calibration")
    if x.daemon is not None:
        there = x.daemon.robot.get("calibration") is not None
    else:
        there = x.calibration is not None or any(_of_calibration(x, each.file) for each in x.wrong_files)
    if not there:
        yield DoctorFinding(
            "CALIBRATION_MISSING",
            robot.name,
            "no calibration file",
            f"one at {x.settings.usual_calibration(robot.name)}",
            advice=f"see {page(CALIBRATION)}; a file elsewhere is named with `--calibration FILE`",
        )


def edited(x: CheckContext) -> Iterator[DoctorFinding]:
    """FILES_EDITED: robot file and calibration as the daemon read them, against what stands there now."""
    daemon = x.need_daemon()
    told = x.need_daemon().robot
    path = Path(str(told["robot"]["path"]))
    if not path.is_absolute():
        raise CheckUnavailable(f"the daemon read {path}, relative to the folder it was started in")
    reload = "twindctl reload"
    if _text_hash(path) not in (told["robot"]["text_sha256"], None):
        yield DoctorFinding("FILES_EDITED", str(path), "changed since the daemon read it", command=reload)
    known: Any = told.get("calibration")
    if known is not None and x.calibration is not None and x.calibration.sha256 != known["sha256"]:
        yield DoctorFinding(
            "FILES_EDITED", f"calibration of {x.need_robot().name}", "changed", command=reload
        )
    if known is None and x.calibration is not None and daemon.status["mode"] != "sim":
        name = f"calibration of {x.need_robot().name}"
        yield DoctorFinding(
            "FILES_EDITED", name, "written since the daemon started, which has none", command=reload
        )


def _of_calibration(x: CheckContext, file: str) -> bool:
    """Is this file the calibration that would be read?"""
    if x.settings is None or x.robot is None:
        return False
    usual = x.settings.state_dir / "calibration" / f"{x.settings.individual or x.robot.name}.yaml"
    return file in (str(x.settings.calibration), str(usual))


def _how_to_mend(code: str) -> str:
    return "correct it there" if code == "FILE_REFUSED" else ""


def _without_range(robot: RobotFile, compiled: Any) -> list[str]:
    """Names, in the model, of driven joints that it does not limit."""
    return [
        joint.model_joint
        for joint in robot.joints
        if not compiled.jnt_limited[compiled.joint(joint.model_joint).id]
    ]


def _ranges(robot: RobotFile, free: list[str]) -> str:
    joint = next(each for each in robot.joints if each.model_joint == free[0])
    span = f"{joint.lower:g}..{joint.upper:g}"
    return (
        f'write range="LOWER UPPER" at these joints of {robot.mjcf_path.name}, as the mechanics allow it; '
        f"the robot file says {span} rad for {joint.name}"
    )


def _text_hash(path: Path) -> str | None:
    """As `RobotFile.text_sha256`; None where it cannot be read."""
    try:
        return hashlib.sha256(path.read_text(encoding="utf-8").encode()).hexdigest()
    except (OSError, ValueError):
        return fingerprint(path) or None


def _some(names: list[str]) -> str:
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return ", ".join(names[:SHOWN]) + more
