"""A calibration file and its numbered predecessors: listing and reading."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from twind.command_line.verb import Rejected
from twind.config.calibration_file import Calibration, load_calibration
from twind.config.robot_spec import RobotFile
from twind.config.yaml_tree import ConfigError

CURRENT = "current"


@dataclass(frozen=True, slots=True)
class CalibrationArchive:
    """Calibration files of one individual robot: `path`, and `NAME.0001.yaml` and up beside it."""

    path: Path
    robot: RobotFile

    def numbers(self) -> Sequence[int]:
        """Return the numbers of the earlier files, the latest last.

        Raises Rejected: the folder is unreadable.
        """
        numbered = re.compile(re.escape(self.path.stem) + r"\.(\d{4,9})\.yaml")
        try:
            names = [each.name for each in self.path.parent.iterdir()]
        except FileNotFoundError:
            return []
        except OSError as error:
            raise Rejected(f"{self.path.parent}: {error.strerror}") from None
        return sorted(int(found[1]) for name in names if (found := numbered.fullmatch(name)))

    def file(self, which: str) -> Path:
        """Return the path of a file that is given by number, by `current`, or by path.

        A path has a slash or ends in .yaml. Raises Rejected where no file has that number.
        """
        if which == CURRENT:
            return self.path
        if "/" in which or which.endswith(".yaml"):
            return Path(which)
        known = self.numbers()
        if not which.isdecimal() or int(which) not in known:
            there = ", ".join(f"{number:04d}" for number in known) or "none"
            raise Rejected(f"no earlier file {which!r} of {self.path}; there are: {there}")
        return self.path.with_name(f"{self.path.stem}.{int(which):04d}.yaml")

    def read(self, which: str) -> Calibration:
        """Load that file. Raises Rejected: it does not exist, or is no calibration of this robot file."""
        file = self.file(which)
        try:
            return load_calibration(file, self.robot)
        except ConfigError as error:
            if error.absent:
                remedy = "`twindctl calibrate sweep`, then `zero`, or `import`, make one"
                raise Rejected(f"{file}: nothing is calibrated yet: {remedy}") from None
            raise Rejected(str(error)) from None
