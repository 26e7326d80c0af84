"""Draft beside the calibration, `twind-calibration-draft/1`: travels of joints that have no zero yet.

Bound to the robot file's description like the calibration itself; each actuator leaves it when it is whole.
"""

import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from twind.command_line.verb import Rejected
from twind.config.atomic_save import draft_of
from twind.config.calibrated_device import DeviceRecord, device_entries, read_device, require_sweep
from twind.config.calibration_file import render
from twind.config.config_reader import ConfigReader, ConfigStruct, Plain, Text
from twind.config.robot_spec import RobotFile
from twind.config.yaml_tree import ConfigError, parse, read_text
from twind_calibration.calibrating import file_ownership
from twind_calibration.calibrating.calibration_context import TOOL, now

FORMAT = "twind-calibration-draft/1"


@dataclass(frozen=True, slots=True)
class DraftTravel:
    """One actuator that was moved from end to end."""

    device: DeviceRecord  # as it was then
    sweep_ticks: tuple[int, int]  # as a calibration file has it
    at: str  # UTC


@dataclass(frozen=True, slots=True)
class CalibrationDraft:
    """By actuator, in no order."""

    swept: Mapping[str, DraftTravel] = field(default_factory=dict)

    @property
    def devices(self) -> dict[str, DeviceRecord]:
        """As each was when it was swept."""
        return {name: one.device for name, one in self.swept.items()}

    def joined(self, name: str, one: DraftTravel) -> "CalibrationDraft":
        """With one more, or the same one anew."""
        return replace(self, swept={**self.swept, name: one})

    def without(self, names: Iterable[str]) -> "CalibrationDraft":
        """Nothing is known of those any more."""
        gone = set(names)
        return replace(self, swept={name: one for name, one in self.swept.items() if name not in gone})

    def after(self, then: "CalibrationDraft", whole: Iterable[str]) -> "CalibrationDraft":
        """Those became whole by what `then` says of them; what was swept since stays."""
        return self.without(name for name in whole if self.swept.get(name) == then.swept.get(name))


def dump(draft: CalibrationDraft, robot: RobotFile) -> str:
    """The file's text."""
    head = {
        "format": FORMAT,
        "robot": robot.name,
        "robot_description_sha256": robot.description_sha256,
        "created": now(),
        "tool": TOOL,
    }
    joints: dict[str, dict[str, Plain]] = {
        name: {
            "device": device_entries(one.device),
            "sweep_ticks": list(one.sweep_ticks),
            "at": one.at,
        }
        for name, one in draft.swept.items()
    }
    return render(head, {"joints": joints})


class DraftKeys(ConfigStruct):
    """Keys of a draft."""

    format: Text
    robot: Text
    robot_description_sha256: Text
    created: Text
    tool: Text
    joints: ConfigReader


class TravelKeys(ConfigStruct):
    """Entry of an actuator that was moved from end to end."""

    device: ConfigReader
    sweep_ticks: tuple[int, int]
    at: Text


def read(text: str, file: str, robot: RobotFile) -> CalibrationDraft:
    """The draft that `text` holds. Raises ConfigError."""
    top = ConfigReader(file, parse(text, file))
    top.require_format(FORMAT)
    given = top.read(DraftKeys)
    if given.robot != robot.name:
        raise top.refuse("robot", f"made for robot {given.robot!r}, not for {robot.name!r}")
    if given.robot_description_sha256 != robot.description_sha256:
        raise top.refuse("robot_description_sha256", "joints, ids, signs or ratios changed since")
    given.joints.require_known(joint.actuator for joint in robot.joints)
    return CalibrationDraft({name: _read_travel(each) for name, each in given.joints.sections().items()})


def _read_travel(section: ConfigReader) -> DraftTravel:
    given = section.read(TravelKeys)
    require_sweep(section, given.sweep_ticks)
    return DraftTravel(read_device(given.device), given.sweep_ticks, given.at)


def path_of(calibration: Path) -> Path:
    """Return the path of the draft of a calibration file."""
    return draft_of(calibration.parent, calibration.stem)


def load(calibration: Path, robot: RobotFile) -> CalibrationDraft:
    """The draft beside a calibration file; an empty one where there is none.

    Raises Rejected: it is another user's, of another description, or broken. Moving it away begins a new one.
    """
    path = path_of(calibration)
    try:
        return read(read_text(path), str(path), robot)
    except ConfigError as error:
        if error.absent:
            return CalibrationDraft()
        if error.forbidden:
            raise Rejected(f"{error}; try with sudo") from None
        raise Rejected(f"{error}. What was swept must be swept again: remove {path}") from None


def require_room(calibration: Path) -> None:
    """Its folder is there, made if need be, and may be written. Raises Rejected."""
    folder = calibration.parent
    try:
        _made(folder)
    except OSError as error:
        raise Rejected(f"{folder} cannot be made: {error.strerror}; try with sudo") from None
    if not os.access(folder, os.W_OK | os.X_OK):
        raise Rejected(f"{folder} may not be written by this user; try with sudo")


def _made(folder: Path) -> None:
    """A folder that root makes belongs to whom the one above it belongs: the daemon has to enter it."""
    if folder.is_dir():
        return
    _made(folder.parent)
    folder.mkdir(mode=0o750)
    if os.geteuid() == 0:
        above = folder.parent.stat()
        os.chown(folder, above.st_uid, above.st_gid)


def change(
    calibration: Path, robot: RobotFile, act: Callable[[CalibrationDraft], CalibrationDraft]
) -> CalibrationDraft:
    """Make the draft what `act` makes of it, as it is by now: others may sweep meanwhile. What it holds then.

    It has the rights of the calibration file, and is removed when nothing is left in it. Raises Rejected as
    `load`, and: it cannot be written.
    """
    path = path_of(calibration)
    with file_ownership.lock_folder(calibration) as folder:
        draft = act(load(calibration, robot))
        with file_ownership.refusing(path):
            if draft.swept:
                folder.save_draft(calibration.stem, dump(draft, robot), file_ownership.rights(calibration))
            else:
                path.unlink(missing_ok=True)
    return draft
