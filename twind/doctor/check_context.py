"""Input of all checks, gathered once and passed in. A check fetches nothing by itself.

Options are interpreted as the daemon would. Opens no port.
"""

import argparse
import os
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

from twind.client import Client, NoDaemon
from twind.command_line.verb import UsageError
from twind.config.calibration_file import Calibration, load_calibration
from twind.config.config_files import bus_ports, refuse_wrong
from twind.config.config_reader import file_error
from twind.config.daemon_settings import DaemonSettings, load_settings
from twind.config.driver_family import family
from twind.config.robot_file import RobotFile, load_robot
from twind.config.robot_spec import BusSpec, JointSpec
from twind.config.yaml_tree import ConfigError
from twind.ctl.instance_paths import SERVICE, settings_of, sockets_of
from twind.doctor.check import CheckNotApplicable, Devices, DoctorFinding
from twind.doctor.family_doctor import InspectorRequest
from twind.doctor.host_inspector import HostInspector, asleep, would_start
from twind.doctor.inspectors import PATIENCE, DaemonInspector
from twind.exceptions import InvalidInput, OperationFailed
from twind_drivers.clock import Clock

Survey = TypeVar("Survey")


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
    wrong_files: tuple[ConfigError, ...] = ()  # errors of settings, robot file and calibration
    ports: Mapping[str, str | None] = field(default_factory=dict)  # by bus: those that a daemon has or takes
    lines: Mapping[str, Any] = field(default_factory=dict)  # inspectors by bus, without a daemon
    surveys: dict[str, Any] = field(default_factory=dict)  # results of inspections that checks share

    def need_robot(self) -> RobotFile:
        """Return the robot. Raises OperationFailed where its file is rejected."""
        if self.robot is None:
            raise OperationFailed("the robot file cannot be read")
        return self.robot

    def need_daemon(self) -> DaemonInspector:
        """Return the daemon. Raises CheckNotApplicable where none can be reached."""
        if self.daemon is None:
            raise CheckNotApplicable("no daemon runs")
        return self.daemon

    @property
    def sim(self) -> bool:
        """True in mode sim, which opens no port and needs no calibration.

        Taken from the running daemon, else from the settings.
        """
        if self.daemon is not None:
            return bool(self.daemon.status["mode"] == "sim")
        return self.settings is not None and self.settings.mode == "sim"

    def about(self) -> dict[str, Any]:
        """Return the subject of the report.

        Robot and whether it is only the default; unit; ports and ids by bus; daemon (socket, …) or None.
        """
        daemon = None
        if self.daemon is not None:
            daemon = {"socket": self.daemon.path}
            with suppress(OperationFailed):
                daemon |= {key: self.daemon.status[key] for key in ("version", "robot", "mode", "state")}
        name = None if self.robot is None else self.robot.name
        joints = () if self.robot is None else self.robot.joints
        ids = {bus: [joint.id for joint in joints if joint.bus == bus] for bus in self.ports}
        by_default = self.settings is not None and "robot" not in self.settings.origins
        return {
            "robot": name,
            "robot_by_default": by_default and self.daemon is None,
            "unit": self.unit,
            "ports": dict(self.ports),
            "ids": ids,
            "daemon": daemon,
        }

    def bus(self, name: str) -> BusSpec:
        """Return a bus of the robot.

        Raises OperationFailed where there is no robot, KeyError for an unknown name.
        """
        return self.need_robot().bus(name)

    def survey_buses(
        self, drivers: Collection[str], *, look: Callable[[BusSpec], Survey], kind: type[Survey]
    ) -> Iterator[Survey]:
        """Yield the survey of each bus of these families, made once by `look`, whose result is a `kind`.

        Raises CheckNotApplicable: there is no such bus; after the others: one failed.
        """
        if self.sim:
            raise CheckNotApplicable("mode sim opens no bus")
        specs = [spec for spec in self.need_robot().buses if spec.kind in drivers]
        if not specs:
            raise CheckNotApplicable
        reasons = []
        for spec in specs:
            if spec.name not in self.surveys:
                try:
                    self.surveys[spec.name] = look(spec)
                except OperationFailed as error:
                    self.surveys[spec.name] = error
            seen = self.surveys[spec.name]
            if isinstance(seen, kind):
                yield seen
            else:
                reasons.append(str(seen))
        if reasons:
            raise OperationFailed("; ".join(dict.fromkeys(reasons)))

    def close(self) -> None:
        """Close the ports and the connection to the daemon."""
        for line in self.lines.values():
            line.close()
        if self.daemon is not None:
            self.daemon.client.close()


@dataclass(frozen=True, slots=True)
class Inspection:
    """One inspection with the codes that it can find. `what`: its subject in a word ("ports")."""

    what: str
    codes: tuple[str, ...]
    look: Callable[[CheckContext], Iterator[DoctorFinding]]


def device_of(joint: JointSpec) -> Devices:
    """Return the device that a joint should have, whether it answers or not."""
    return Devices(joint.bus, [(joint.id, joint.name)])


def is_armed(context: CheckContext) -> bool:
    """Return whether a daemon answers and is armed."""
    return context.daemon is not None and bool(context.daemon.status["armed"])


def examine(options: argparse.Namespace, host: HostInspector, clock: Clock) -> CheckContext:
    """Gather files and daemon once. Raises UsageError for options that are invalid as written."""
    wrong: list[ConfigError] = []
    own = _settings(options, host, None, wrong)
    place = _place(options, own, host)
    daemon, no_daemon, stopped = _daemon(place, host)
    other_ports = daemon is not None and not _same_ports(options, daemon)
    if daemon is not None and other_ports:
        no_daemon = NoDaemon(f"{daemon.path}: a daemon answers there, but it has other ports")
        daemon.client.close()
        daemon = None
    settings = own
    if daemon is not None and not options.config and (source := _source(daemon)) is not None:
        wrong.clear()  # what this user's own file is like is no matter of that daemon
        settings = _settings(options, host, source, wrong)
    settings = _with_paths_in_force(settings, daemon, options.calibration)
    robot = _robot(settings, daemon, wrong)
    result = CheckContext(
        host=host,
        unit=unit_of(settings, host),
        sockets=place or "",
        no_daemon=no_daemon,
        asleep=stopped,
        other_ports=other_ports,
        daemon=daemon,
        settings=settings,
        robot=robot,
        calibration=_calibration(settings, robot, wrong),
        ports=_ports(options, settings, robot, daemon, wrong),
    )
    result.wrong_files = tuple({str(error): error for error in wrong}.values())
    if robot is not None and daemon is None:
        result.lines = {
            name: doctor.load().inspector(
                InspectorRequest(port, robot.bus(name), robot, host, clock, no_daemon)
            )
            for name, port in result.ports.items()
            if port is not None and (doctor := family(robot.bus(name).kind).doctor) is not None
        }
    return result


def unit_of(settings: DaemonSettings | None, host: HostInspector) -> str:
    """Return the service: twind@NAME.service for settings in /etc/twind/NAME.yaml, else twind.service."""
    source = Path(settings.source) if settings is not None else Path("defaults")
    name = source.stem if source.parent == host.etc / "twind" else SERVICE
    return f"{SERVICE}.service" if name == SERVICE else f"{SERVICE}@{name}.service"


def _settings(
    options: argparse.Namespace, host: HostInspector, source: Path | None, wrong: list[ConfigError]
) -> DaemonSettings | None:
    """Load the daemon settings from the first source that exists.

    Order: --config, the file that the daemon has read, the settings of this user, those of the service.
    Appends a configuration error to `wrong` and returns None. Raises UsageError: the error is in the command
    line.
    """
    service = host.etc / "twind" / f"{SERVICE}.yaml"
    file = Path(options.config) if options.config else source or settings_of(options.socket, service.parent)
    try:
        if file is None:
            found = load_settings(None, host.environ, host.uid)
            if found.source == "defaults" and service.exists():
                found = load_settings(service, {}, 0)
        elif file.parent == service.parent:  # the service's folders, whoever asks
            found = load_settings(file, {}, 0)
        else:
            found = load_settings(file, host.environ, host.uid)
        return found.override(robot=options.robot, calibration=options.calibration, ports=options.port)
    except ConfigError as error:
        if error.file == "command line":
            raise UsageError(error.message) from None
        wrong.append(error)
        return None


def _with_paths_in_force(
    settings: DaemonSettings | None, daemon: DaemonInspector | None, calibration: str | None
) -> DaemonSettings | None:
    """Return the settings with the state folder and the calibration that the running daemon reports.

    Its command line and environment may name others than its file. `calibration`: of the command line here.
    """
    if settings is None or daemon is None:
        return settings
    try:
        reported = daemon.parameters
        state = Path(reported["state_dir"])
    except (OperationFailed, KeyError):  # in trouble, or of another version
        return settings
    given = calibration or reported.get("calibration")
    return replace(
        settings,
        individual=reported.get("individual"),
        calibration=None if given is None else Path(given),
        state_dir=state,
    )


def _place(options: argparse.Namespace, settings: DaemonSettings | None, host: HostInspector) -> str | None:
    """Return the folder of the sockets, if an option or the settings name one."""
    if options.socket is None and options.config and settings is not None:
        return sockets_of(options.config, str(settings.socket_dir), host.etc / "twind")
    place: str | None = options.socket
    return place


def _daemon(place: str | None, host: HostInspector) -> tuple[DaemonInspector | None, NoDaemon | None, str]:
    """Return the daemon of these sockets, or the reason why it is unreachable. Starts none.

    Also returns the stopped service that a connection would start ("": none).
    """
    refused: NoDaemon | None = None
    for name in ("observe", "control"):
        client = Client(place, name=name, timeout=PATIENCE)
        if service := asleep(host, client.path):
            return None, NoDaemon(f"{client.path}: {would_start(service)}", absent=True), service
        try:
            client.connect()
        except NoDaemon as error:
            if refused is None or refused.absent:  # one that may be there says more
                refused = error
            continue
        return DaemonInspector(client), None, ""
    return None, refused, ""


def _source(daemon: DaemonInspector) -> Path | None:
    """Return the settings file that a daemon has read; None: it has read none, or this is unknown."""
    try:
        source = str(daemon.parameters.get("source") or "defaults")
    except OperationFailed:
        return None
    return Path(source) if source.startswith("/") else None


def _same_ports(options: argparse.Namespace, daemon: DaemonInspector) -> bool:
    """Return whether the ports of the command line are among the daemon's; True without any."""
    try:
        its = {real_port(bus["port"]) for bus in daemon.status["buses"]}
    except OperationFailed:
        return True
    return {real_port(port.partition("=")[2] or port) for port in options.port} <= its


def real_port(port: str) -> str:
    """Return a port with the kernel's name of its device; for a CAN port, of the device of its channel."""
    scheme, start, path = port.partition(":/") if port.startswith("can:") else ("", "", port)
    if not start:
        return os.path.realpath(path) if path else port
    return f"{scheme}:{os.path.realpath('/' + path)}"


def _robot(
    settings: DaemonSettings | None, daemon: DaemonInspector | None, wrong: list[ConfigError]
) -> RobotFile | None:
    """Load the robot file of the daemon as it is now, else that of the settings."""
    name = None if settings is None else settings.robot
    if daemon is not None:
        # A daemon in trouble, or a newer one: the settings name the file too.
        with suppress(OperationFailed, KeyError):
            name = str(daemon.robot["robot"]["path"])
    if name is None:
        return None
    try:
        return load_robot(name, () if settings is None else settings.robot_folders)
    except ConfigError as error:
        wrong.append(error)
        return None


def _calibration(
    settings: DaemonSettings | None, robot: RobotFile | None, wrong: list[ConfigError]
) -> Calibration | None:
    if settings is None or robot is None:
        return None
    try:
        path = settings.calibration_path(robot.name)
        return None if path is None else load_calibration(path, robot)
    except ConfigError as error:
        wrong.append(error)
        return None


def _ports(
    options: argparse.Namespace,
    settings: DaemonSettings | None,
    robot: RobotFile | None,
    daemon: DaemonInspector | None,
    wrong: list[ConfigError],
) -> Mapping[str, str | None]:
    """Return the ports by bus: those of the daemon, else those that it would use.

    Raises UsageError: the command line is wrong.
    """
    if daemon is not None:
        with suppress(OperationFailed):
            return {bus["name"]: bus["port"] or None for bus in daemon.status["buses"]}
    if settings is None or robot is None:
        return {}
    described = {bus.name: bus.port for bus in robot.buses}
    try:
        ports = bus_ports(settings, list(described), described)
        refuse_wrong(robot, ports)
    except InvalidInput as error:
        if options.port:
            raise UsageError(str(error)) from None
        wrong.append(file_error(settings.source, f"ports: {error}"))
        return {}
    return ports
