"""The robot, its ports and its calibration file, as the daemon with the same options would take them."""

import argparse
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from twind.command_line.verb import Rejected, UsageError
from twind.config.config_files import bus_ports, refuse_wrong
from twind.config.daemon_settings import DaemonSettings, load_settings
from twind.config.robot_file import load_robot
from twind.config.robot_spec import RobotFile
from twind.config.yaml_tree import ConfigError
from twind.ctl.instance_paths import settings_of, sockets_of
from twind.exceptions import InvalidInput

SERVICE = Path("/etc/twind/twind.yaml")


@dataclass(frozen=True, slots=True)
class RobotDescription:
    """Contents of settings, robot file and calibration."""

    robot: RobotFile
    ports: Mapping[str, str | None]  # by bus; None: not named
    calibration: Path | None  # None: none was named, and the individual has none yet
    usual: Path  # where the individual's stands when no file is named
    sockets: Path  # where its daemon would listen

    def port(self, bus: str) -> str:
        """The port of a bus. Raises UsageError that says how to name it."""
        port = self.ports[bus]
        if port is None:
            raise UsageError(f"bus {bus} of {self.robot.name} has no port: say --port {bus}=PORT")
        return port


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options that say which robot, on which port, with which calibration."""
    parser.add_argument("--config", metavar="FILE", help="settings of the daemon (default: its usual place)")
    parser.add_argument("--robot", metavar="NAME|FILE", help="instead of the robot of the settings")
    parser.add_argument("--port", action="append", default=[], metavar="[BUS=]PORT", help="instead of theirs")
    parser.add_argument("--calibration", metavar="FILE", help="instead of theirs")


def read(options: argparse.Namespace) -> RobotDescription:
    """Everything, as `twind` with the same options would. Raises Rejected, UsageError.

    Without --config the sockets that were named (`-i NAME`) say whose settings are meant.
    """
    try:
        settings = _settings(options.config or settings_of(options.socket, SERVICE.parent)).override(
            robot=options.robot, calibration=options.calibration, ports=options.port
        )
        robot = load_robot(settings.robot, settings.robot_folders)
        named = {bus.name: bus.port for bus in robot.buses}
        ports = bus_ports(settings, list(named), named)
        refuse_wrong(robot, ports)
        source = None if settings.source == "defaults" else settings.source
        sockets = sockets_of(source, str(settings.socket_dir), SERVICE.parent)
        usual = settings.usual_calibration(robot.name)
        return RobotDescription(robot, ports, settings.calibration_path(robot.name), usual, Path(sockets))
    except InvalidInput as error:
        raise UsageError(str(error)) from None
    except ConfigError as error:
        raise Rejected(str(error)) from None


def _settings(config: str | Path | None) -> DaemonSettings:
    """The named file, this user's own, else the service's."""
    if config is not None:
        path = Path(config)
        return load_settings(path, {}, 0) if path.parent == SERVICE.parent else load_settings(path)
    own = load_settings(None)
    return load_settings(SERVICE, {}, 0) if own.source == "defaults" and SERVICE.exists() else own
