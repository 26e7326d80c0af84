"""Basis of every calibration step: the daemon, its robot file, and the calibration file.

The daemon reports the robot file that it has read and the path of the calibration. A step without options
therefore writes the file that the daemon will read.
"""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from math import nan
from pathlib import Path
from typing import Any

from twind.client import CallError, Client
from twind.command_line.verb import Rejected, UsageError
from twind.config.calibration_file import Calibration, load_calibration, set_aside
from twind.config.daemon_settings import usual_calibration
from twind.config.robot_file import read_robot
from twind.config.robot_spec import RobotFile
from twind.config.yaml_tree import ConfigError
from twind.version import __version__
from twind_calibration.rejection_hints import unknown_joint

TOOL = f"twind {__version__}"


@dataclass(frozen=True, slots=True)
class CalibrationContext:
    """The robot as its daemon describes it, and its calibration file, which need not exist yet."""

    robot: RobotFile
    path: Path  # of the calibration file
    named: bool  # the daemon got this file by name: it does not start without it
    rate_hz: float = nan  # of its readings; NaN: not queried

    @property
    def individual(self) -> str:
        """Name of the individual robot that the calibration belongs to: the file's name without suffix."""
        return self.path.stem

    def calibration(self) -> Calibration | None:
        """Load the current file; None: there is none.

        Raises Rejected with the reason where it is unusable.
        """
        try:
            return load_calibration(self.path, self.robot)
        except ConfigError as error:
            if error.absent:
                return None
            if error.forbidden:
                raise Rejected(f"{error}; try with sudo") from None
            raise Rejected(
                f"{error}. Put an earlier file back (`twindctl calibrate rollback`), or move this one away "
                f"({set_aside(self.path)}): what is measured then begins a new file"
            ) from None

    def select_actuators(self, names: Sequence[str], known: Sequence[str]) -> list[str]:
        """Return the named actuators, each once and in the order of the robot; all where none is named.

        Raises Rejected for a name that is not in `known`.
        """
        for name in names:
            if name not in known:
                raise unknown_joint(self.robot.name, name, known)
        return [name for name in known if name in names or not names]


def ground(options: argparse.Namespace, client: Client) -> CalibrationContext:
    """Query the daemon for the context.

    Raises Rejected (robot file changed since, or another), ClientError.
    """
    answer = client.call("GetRobot")["robot"]
    parameters = client.call("GetParameters")["parameters"]
    robot = _robot(answer)
    rate = float(parameters.get("rate_hz") or robot.rate_hz)
    if options.calibration:
        path = Path(options.calibration).absolute()
        if path.suffix != ".yaml":
            raise UsageError(f"--calibration {options.calibration}: a calibration file is named NAME.yaml")
        return CalibrationContext(robot, path, named=True, rate_hz=rate)
    path = _path(parameters, robot.name)
    return CalibrationContext(robot, path, named=bool(parameters.get("calibration")), rate_hz=rate)


def calibration_path(client: Client, robot_name: str) -> Path:
    """Return the calibration file of the daemon, which need not exist yet. Raises ClientError."""
    return _path(client.call("GetParameters")["parameters"], robot_name)


def _path(parameters: Mapping[str, Any], robot_name: str) -> Path:
    if parameters.get("calibration"):
        return Path(parameters["calibration"])
    return usual_calibration(Path(parameters["state_dir"]), parameters.get("individual") or robot_name)


def _robot(answer: dict[str, Any]) -> RobotFile:
    """Load the robot file that the daemon has read. Raises Rejected: it has changed since."""
    try:
        robot = read_robot(Path(answer["path"]))
    except ConfigError as error:
        raise Rejected(f"the robot file of the daemon cannot be read: {error}") from None
    if robot.text_sha256 != answer["text_sha256"]:
        raise Rejected(f"{robot.path} was changed since the daemon read it: restart the daemon, then again")
    return robot


def scanned(client: Client, bus: str) -> dict[int, dict[str, object]]:
    """Return the devices that answer on a bus, by id, with their identification data.

    Raises Rejected, ClientError.
    """
    try:
        return {int(found["id"]): found for found in client.stream("Scan", bus=bus)}
    except CallError as error:
        if error.name == "BusFailed":
            raise Rejected(f"bus {bus}: {error}") from error
        raise


def now() -> str:
    """Return the current UTC time in the format of a calibration file."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
