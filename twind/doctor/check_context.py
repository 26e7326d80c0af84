"""Input of all checks, gathered once and passed in. A check fetches nothing by itself."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from twind.client import NoDaemon
from twind.config.calibration_file import Calibration
from twind.config.daemon_settings import DaemonSettings
from twind.config.robot_file import RobotFile
from twind.config.robot_spec import BusSpec
from twind.config.yaml_tree import ConfigError
from twind.doctor.can_bus_inspector import CanBusInspector
from twind.doctor.check import CheckNotApplicable, CheckUnavailable
from twind.doctor.daemon_inspector import DaemonInspector
from twind.doctor.host_inspector import HostInspector
from twind.doctor.serial_bus_inspector import SerialBusInspector


@dataclass
class CheckContext:
    """One machine, its files, its daemon or the free ports of its buses."""

    host: HostInspector
    unit: str  # twind.service, twind@NAME.service: the service of these settings
    sockets: str = ""  # the folder where a daemon was looked for; "": the usual ones
    no_daemon: NoDaemon | None = None  # why none can be reached; None: one answers
    asleep: str = ""  # the stopped service that a connection would start; it is not connected to
    other_ports: bool = False  # a daemon answers, and has other ports than this call names
    daemon: DaemonInspector | None = None  # None: none can be reached
    settings: DaemonSettings | None = None
    robot: RobotFile | None = None  # the daemon's, if one runs and its file can be read
    calibration: Calibration | None = None
    wrong_files: tuple[ConfigError, ...] = ()  # what settings, robot, calibration, model say of themselves
    ports: Mapping[str, str | None] = field(
        default_factory=dict
    )  # by bus, as the daemon has or would have them
    lines: Mapping[str, SerialBusInspector] = field(
        default_factory=dict
    )  # by bus: serial ports that nobody holds; no daemon
    can_lines: Mapping[str, CanBusInspector] = field(default_factory=dict)  # by bus: CAN channels; no daemon
    surveys: dict[str, Any] = field(default_factory=dict)  # what was looked up once, for every check

    def need_robot(self) -> RobotFile:
        """Return the robot. Raises CheckUnavailable where its file is rejected."""
        if self.robot is None:
            raise CheckUnavailable("the robot file cannot be read")
        return self.robot

    def need_daemon(self) -> DaemonInspector:
        """Return the daemon. Raises CheckNotApplicable where none can be reached."""
        if self.daemon is None:
            raise CheckNotApplicable("no daemon runs")
        return self.daemon

    @property
    def sim(self) -> bool:
        """Whether the mode is sim, which opens no port and needs no calibration.

        Taken from the running daemon, else from the settings.
        """
        if self.daemon is not None:
            return bool(self.daemon.status["mode"] == "sim")
        return self.settings is not None and self.settings.mode == "sim"

    def about(self) -> dict[str, Any]:
        """Return the subject of the report.

        Robot, unit, ports and ids by bus; daemon (socket, version, …) or None.
        """
        daemon = None
        if self.daemon is not None:
            daemon = {"socket": self.daemon.path}
            with suppress(CheckUnavailable):
                daemon |= {key: self.daemon.status[key] for key in ("version", "robot", "mode", "state")}
        name = None if self.robot is None else self.robot.name
        joints = () if self.robot is None else self.robot.joints
        ids = {bus: [joint.id for joint in joints if joint.bus == bus] for bus in self.ports}
        return {"robot": name, "unit": self.unit, "ports": dict(self.ports), "ids": ids, "daemon": daemon}

    def bus(self, name: str) -> BusSpec:
        """Return a bus of the robot.

        Raises CheckUnavailable where there is no robot, KeyError for an unknown name.
        """
        return self.need_robot().bus(name)

    def close(self) -> None:
        """Close the ports and the connection to the daemon."""
        for line in self.lines.values():
            line.close()
        for channel in self.can_lines.values():
            channel.close()
        if self.daemon is not None:
            self.daemon.client.close()
