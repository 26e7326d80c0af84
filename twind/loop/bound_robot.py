"""A robot as the loop needs it: described, calibrated or not, bound to its model. Loop's process."""

from collections.abc import Mapping
from dataclasses import dataclass

from twind.config.calibration_file import Calibration
from twind.config.device_check import compare
from twind.config.hot_changes import Changes, applied
from twind.config.robot_spec import RobotFile
from twind.robot.finding import Verdict
from twind.twin.binding import Binding, rebound
from twind_drivers.bus import IdentifiedDevice


@dataclass(frozen=True, slots=True)
class BoundRobot:
    """One robot; both sides of the link judge the same."""

    file: RobotFile
    calibration: Calibration | None
    binding: Binding

    def judge(self, devices: Mapping[tuple[str, int], IdentifiedDevice]) -> Verdict:
        """CALIB_MISMATCH: do the devices hold what the calibration was made with?"""
        return compare(self.file, self.calibration, devices)

    def with_changes(self, changes: Changes) -> "BoundRobot":
        """The same with these changes. Raises NotHot, BindingError."""
        file = applied(self.file, changes)
        return BoundRobot(file, self.calibration, rebound(self.binding, file, self.calibration))
