"""Files of a fit: robot, calibration, and the place of the result. Checked before a robot moves for it."""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from twind.command_line.verb import UsageError
from twind.config.calibration_file import Calibration, load_calibration
from twind.config.identified_file import require_writable
from twind.config.identified_spec import IdentifiedModel
from twind.config.robot_file import RobotFile, load_robot
from twind.exceptions import InvalidInput
from twind.twin.binding import Binding, bind


@dataclass(frozen=True, slots=True)
class FitFiles:
    """Robot without an identified model, and its calibration where one is named."""

    robot: RobotFile
    calibration: Calibration | None
    plain: Binding

    def bound_with(self, model: IdentifiedModel) -> Binding:
        """Return the robot with an identified model."""
        return bind(replace(self.robot, identified=model), self.calibration)

    def require_joints(self, names: Sequence[str]) -> None:
        """Require that a motion has the joints of this robot, in order. Raises InvalidInput."""
        if tuple(names) != self.plain.robot.names:
            raise InvalidInput(
                f"its joints are not those of {self.plain.robot.name}: {', '.join(self.plain.robot.names)}"
            )


def require_place(options: argparse.Namespace) -> None:
    """Require a place for the result of --write. Raises UsageError, ConfigError."""
    if not options.write:
        return
    if options.robot is None or options.calibration is None:
        raise UsageError(
            "--write needs --robot and --calibration: the model is written beside the calibration"
        )
    require_writable(Path(options.calibration))


def load_fit_files(options: argparse.Namespace, recorded: Mapping[str, Any] | None) -> FitFiles:
    """Load the named robot, else the recorded one, and its calibration.

    Raises ConfigError, InvalidInput: a file that cannot be used; UsageError: no robot is named.
    """
    named = options.robot or (recorded or {}).get("path")
    if named is None:
        raise UsageError("the recording holds no robot: name it by --robot")
    robot = replace(load_robot(named), identified=None)
    calibration = options.calibration and load_calibration(options.calibration, robot)
    return FitFiles(robot, calibration, bind(robot, calibration))
