"""A robot as the loop uses it: its file, its calibration if any, and its binding to the model.

Loop's process.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from twind.config.calibration_file import Calibration
from twind.config.device_check import compare
from twind.config.hot_changes import Changes, applied
from twind.config.robot_spec import RobotFile
from twind.robot.arrays import Floats
from twind.robot.finding import Verdict
from twind.twin.binding import Binding, rebound
from twind_drivers.bus import IdentifiedDevice


@dataclass(frozen=True, slots=True)
class BoundRobot:
    """A robot file with calibration and model binding; loop and front judge with the same values."""

    file: RobotFile
    calibration: Calibration | None
    binding: Binding

    def judge(self, devices: Mapping[tuple[str, int], IdentifiedDevice]) -> Verdict:
        """Return CALIB_MISMATCH findings for devices that differ from those of the calibration."""
        return compare(self.file, self.calibration, devices)

    def pose(self, name: str) -> Floats:
        """Return a pose of the robot file (n,), rad. Raises KeyError."""
        return np.array([self.file.poses[name][joint] for joint in self.file.names])

    def with_changes(self, changes: Changes) -> "BoundRobot":
        """Return the same robot with these changes. Raises NotHot, InvalidInput."""
        file = applied(self.file, changes)
        return BoundRobot(file, self.calibration, rebound(self.binding, file, self.calibration))
