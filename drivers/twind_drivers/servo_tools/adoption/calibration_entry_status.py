"""Calibration entry of a replaced servo; it is removed before the new servo answers.

A new servo of the same model may hold the very registers that were recorded of the old one, and its travel
and its zero are others: with the old entry the daemon would move it to wrong places. The draft beside the
file is struck as well, or the next `zero` would take the old servo's travel for the new one's.
"""

from dataclasses import dataclass, replace
from pathlib import Path

from twind.command_line.verb import Rejected
from twind.config.calibration_file import Calibration, load_calibration, set_aside
from twind.config.robot_spec import RobotFile
from twind.config.yaml_tree import ConfigError
from twind_calibration.calibrating import calibration_draft as drafts
from twind_calibration.calibrating import file_ownership


@dataclass(frozen=True, slots=True)
class CalibrationEntryStatus:
    """Entries of one actuator in the calibration file and in its draft."""

    robot: RobotFile
    path: Path  # where the file stands, or would
    calibration: Calibration | None  # None: there is no file
    draft: drafts.CalibrationDraft
    joint: str

    @property
    def there(self) -> bool:
        """The joint is calibrated, by this file."""
        return self.calibration is not None and self.joint in self.calibration.by_name

    @property
    def has_travel(self) -> bool:
        """The joint has a travel in the draft, and no zero to it yet."""
        return self.joint in self.draft.swept

    def __str__(self) -> str:
        if self.calibration is None:
            return "there is no calibration file"
        if not self.there:
            return f"{self.joint} is not in {self.path}"
        return f"calibrated in {self.path} of {self.calibration.created}"

    def lines(self) -> list[str]:
        """Describe the entries that adoption removes."""
        said = []
        if self.there:
            said.append(f"{self.joint} is {self}: its entry is taken out, the earlier file is kept")
        if self.has_travel:
            said.append(f"{self.joint} was swept, {self.draft.swept[self.joint].at}: its travel is taken out")
        return said

    def strike_out(self) -> None:
        """Take the joint out of both, owner, group and mode kept; the earlier file stays as history.

        Raises Rejected: one cannot be written.
        """
        try:
            if self.has_travel:
                drafts.change(self.path, self.robot, lambda known: known.without([self.joint]))
            if self.there:
                self._strike_from_file()
        except Rejected as error:
            raise Rejected(
                f"the entry of {self.joint} must go before another servo takes its place: {error}. "
                "Nothing was written to the servo"
            ) from None

    def _strike_from_file(self) -> None:
        """From what it says by now: others may have calibrated other joints."""
        with file_ownership.lock_folder(self.path) as folder:
            known = _loaded(self.robot, self.path, self.joint)
            joints = tuple(each for each in known.joints if each.name != self.joint)
            if joints != known.joints:
                file_ownership.save(replace(known, joints=joints), self.path, folder)


def entry_of(robot: RobotFile, path: Path | None, joint: str, usual: Path) -> CalibrationEntryStatus:
    """Return the entries of a joint in the file at `path` and in its draft.

    `path` None: no file exists yet, its place would be `usual`. Raises Rejected: one of them is unreadable.
    """
    place = usual if path is None else path
    calibration = None if path is None else _loaded(robot, path, joint)
    return CalibrationEntryStatus(robot, place, calibration, drafts.load(place, robot), joint)


def _loaded(robot: RobotFile, path: Path, joint: str) -> Calibration:
    try:
        return load_calibration(path, robot)
    except ConfigError as error:
        away = f"or {set_aside(path)} moves the file away"
        raise Rejected(f"{error}. Its entry of {joint} must be readable first, {away}") from None
