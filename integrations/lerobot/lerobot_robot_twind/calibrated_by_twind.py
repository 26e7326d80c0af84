"""Part of a device of LeRobot that twind does: calibration and settings."""


class CalibratedByTwind:
    """A device that LeRobot neither calibrates nor configures."""

    @property
    def is_calibrated(self) -> bool:
        """True: twind arms only calibrated joints."""
        return True

    def calibrate(self) -> None:
        """Do nothing: `twindctl calibrate` does it."""

    def configure(self) -> None:
        """Do nothing: the robot file has gains and limits."""
