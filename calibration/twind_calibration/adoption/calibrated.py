"""What a calibration file says of a servo that is no longer there: struck out before a new one answers.

A new servo of the same model may hold the very registers that were recorded of the old one, and its zero is
another: with the old entry the daemon would move it to wrong places.
"""

from dataclasses import dataclass, replace
from pathlib import Path

from twind.config.calibration_file import Calibration, load_calibration
from twind.config.located import ConfigError
from twind.config.robot_spec import RobotFile
from twind.ctl.verb import Rejected
from twind_calibration.calibrating.kept import save


@dataclass(frozen=True, slots=True)
class Entry:
    """What the calibration file says of one joint, by its actuator's name. `calibration` None: no file."""

    path: Path | None
    calibration: Calibration | None
    joint: str

    @property
    def there(self) -> bool:
        """The joint is calibrated, by this file."""
        return self.calibration is not None and self.joint in self.calibration.by_name

    def __str__(self) -> str:
        if self.calibration is None:
            return "there is no calibration file"
        if not self.there:
            return f"{self.joint} is not in {self.path}"
        return f"calibrated in {self.path} of {self.calibration.created}"

    def strike_out(self) -> None:
        """Take the joint out of the file, owner, group and mode kept; the earlier file stays as history.

        Raises Rejected: it cannot be written.
        """
        if self.path is None or self.calibration is None or not self.there:
            return
        joints = tuple(each for each in self.calibration.joints if each.name != self.joint)
        try:
            save(replace(self.calibration, joints=joints), self.path)
        except Rejected as error:
            raise Rejected(
                f"the entry of {self.joint} must go before another servo takes its place: {error}. "
                "Nothing was written to the servo"
            ) from None


def entry_of(robot: RobotFile, path: Path | None, joint: str) -> Entry:
    """What the file at `path` says of a joint. Raises Rejected: it is there and cannot be read."""
    if path is None:
        return Entry(None, None, joint)
    try:
        return Entry(path, load_calibration(path, robot), joint)
    except ConfigError as error:
        raise Rejected(f"{error}. Until it can be read nobody knows what it says of {joint}") from None
