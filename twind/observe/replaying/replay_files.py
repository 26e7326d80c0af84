"""Files of a recording in a folder of their own, so that a daemon reads them and no others.

A recording is untrusted: nothing in it is executed, and nothing is written outside that folder.
"""

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from twind.briefing import Briefing
from twind.config.calibration_file import FORMAT as CALIBRATION
from twind.config.robot_file import load_robot
from twind.config.robot_spec import RobotFile
from twind.config.yaml_tree import ConfigError
from twind.exceptions import OperationFailed
from twind.observe.recording.foreign_content import FOREIGN
from twind.observe.replaying.replay_script import VIEW

SETTINGS = ("rate_hz", "log_level")  # of the daemon's parameters, those that a replay takes over
THRESHOLDS = ("latency_warn_ms", "latency_block_ms")


@dataclass(frozen=True, slots=True)
class ReplayFiles:
    """Files and buses that a daemon is started with."""

    robot: Path
    buses: tuple[str, ...]  # of that robot file: each needs a port, or the daemon opens the one in the file
    calibration: Path | None
    config: Path
    state: Path


def lay_out(briefing: Briefing, folder: Path, robot: Path | None = None) -> ReplayFiles:
    """The files of a recording in `folder`. `robot`: a file to use instead of the recorded one.

    Raises OperationFailed: they are not in it, cannot be laid out, or have other buses than were recorded.
    """
    try:
        return _laid_out(briefing, folder, robot)
    except (OSError, *FOREIGN) as error:  # names that are too long, hold a NUL, or are file and folder
        raise OperationFailed(f"its files cannot be laid out: {error}") from None


def _laid_out(briefing: Briefing, folder: Path, robot: Path | None) -> ReplayFiles:
    placed = _placed(briefing.texts, folder / "files")
    for path, text in placed.values():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    own, _ = placed.get(_absolute(str(briefing.description.get("path", ""))), (Path(), ""))
    if not own.name and robot is None:
        raise OperationFailed(
            f"the recording does not hold its robot file: name it with --robot FILE; or {VIEW}"
        )
    calibrations = [path for path, text in placed.values() if f"format: {json.dumps(CALIBRATION)}" in text]
    described = _described(robot or own)
    _require_buses(described, briefing)
    state = folder / "state"
    config = folder / "twind.yaml"
    state.mkdir()
    config.write_text(_settings(briefing, state))
    names = tuple(bus.name for bus in described.buses)
    return ReplayFiles(
        described.path.absolute(), names, calibrations[0] if calibrations else None, config, state
    )


def _described(robot: Path) -> RobotFile:
    """As the daemon will read it. Raises OperationFailed."""
    try:
        return load_robot(str(robot))
    except ConfigError as error:
        raise OperationFailed(
            f"its robot file is refused ({error}); another one: --robot FILE; or {VIEW}"
        ) from None


def _require_buses(robot: RobotFile, briefing: Briefing) -> None:
    """A bus of the file that was not recorded would keep the port of that file, which is of this machine.

    Raises OperationFailed.
    """
    wanted = [f"{bus.get('name')} ({bus.get('kind')})" for bus in briefing.description.get("buses", ())]
    there = [f"{bus.name} ({bus.kind})" for bus in robot.buses]
    if wanted != there:
        raise OperationFailed(
            f"{robot.path.name} has the buses {', '.join(there)}; recorded were "
            f"{', '.join(wanted) or 'none'}: name the file that was used then by --robot FILE; or {VIEW}"
        )


def _placed(texts: Mapping[str, str], folder: Path) -> dict[str, tuple[Path, str]]:
    """Recorded path -> where it goes, and the text: below `folder`, as they stood to each other."""
    paths = {_absolute(path): text for path, text in texts.items()}
    if not paths:
        return {}
    common = PurePosixPath(os.path.commonpath([str(PurePosixPath(path).parent) for path in paths]))
    return {path: (folder / PurePosixPath(path).relative_to(common), text) for path, text in paths.items()}


def _absolute(path: str) -> str:
    """Without `..`: as the file system would have it but for links. Relative ones hang below the root."""
    return os.path.normpath("/" + path.lstrip("/"))


def _settings(briefing: Briefing, state: Path) -> str:
    """The settings file: JSON is YAML."""
    given = briefing.parameters
    made = {key: given[key] for key in SETTINGS if given.get(key) is not None}
    made["thresholds"] = {key: given[key] for key in THRESHOLDS if given.get(key) is not None}
    return json.dumps(made | {"state_dir": str(state)})
