"""Configuration of `twind` from files and command line, read and checked together.

Used at start, and again by the process that checks the files for changes.
"""

import hashlib
import os
import pickle
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from twind.config.calibration_file import Calibration, load_calibration, set_aside
from twind.config.cycle_budget import require_rate
from twind.config.daemon_settings import COMMAND_LINE, DaemonSettings, load_settings
from twind.config.doc_pages import CALIBRATION, page
from twind.config.driver_family import family
from twind.config.file_changes import fingerprints
from twind.config.identified_file import identified_path, load_identified
from twind.config.port_names import SCHEME, wrong_port
from twind.config.robot_file import RobotFile, load_robot
from twind.config.yaml_tree import ConfigError, FilePosition
from twind.exceptions import InvalidInput
from twind.robot.finding import Finding, ReasonCode

SHOWN_ITEMS = 6  # open items of a robot file that a refusal names


@dataclass(frozen=True, slots=True)
class ConfigSources:
    """Options of the command line; None and (): not given. `config`: the settings file; None: the default."""

    config: str | None = None
    mode: str | None = None
    robot: str | None = None
    calibration: str | None = None
    identified: str | None = None
    socket: str | None = None
    rate_hz: float | None = None
    ports: tuple[str, ...] = ()
    made_from_file: bool = False  # virtual devices, of which the robot file's open items are true

    def settings(self) -> DaemonSettings:
        """The settings file with the command line over it. Raises ConfigError."""
        return load_settings(Path(self.config) if self.config else None).override(
            mode=self.mode,
            robot=self.robot,
            calibration=self.calibration,
            socket=self.socket,
            rate_hz=self.rate_hz,
            ports=self.ports,
        )


@dataclass(frozen=True, slots=True)
class LoadedConfig:
    """Contents of the files, each checked alone and with the others; not yet bound to the model."""

    settings: DaemonSettings
    robot: RobotFile
    ports: Mapping[str, str | None]  # by bus
    calibration: Calibration | None
    rate_hz: float
    files: Mapping[str, str]  # absolute path -> sha256, of every file of the robot as it was read
    live_denied: Finding | None  # why this daemon may not write to this robot; None: it may


def pack(sources: ConfigSources, described: LoadedConfig) -> bytes:
    """Serialise file contents and their sources for the process that reads the files again.

    Pickled: it is of our own making, like the bound robot beside it, and travels in a sealed memfd.
    """
    return pickle.dumps((sources, described))


def unpacked(data: bytes) -> tuple[ConfigSources, LoadedConfig]:
    """Restore the result of `pack`. Raises ValueError for anything else."""
    try:
        sources, described = pickle.loads(data)
    except Exception as error:  # noqa: BLE001  a broken handover is one error, whatever pickle calls it
        raise ValueError(f"nothing is known of the files: {error!r}") from None
    if not isinstance(sources, ConfigSources) or not isinstance(described, LoadedConfig):
        raise ValueError(f"nothing is known of the files: {type(described).__name__}")
    return sources, described


def describe(sources: ConfigSources, settings: DaemonSettings | None = None) -> LoadedConfig:
    """Read settings (unless given), robot, calibration, identified model. Raises ConfigError, UsageError."""
    settings = sources.settings() if settings is None else settings
    robot = load_robot(settings.robot, settings.robot_folders)
    ports = bus_ports(
        settings, [bus.name for bus in robot.buses], {bus.name: bus.port for bus in robot.buses}
    )
    refuse_wrong(robot, ports)
    path = settings.calibration_path(robot.name)
    usual = settings.usual_calibration(robot.name)
    overlay = overlay_path(settings, robot.name, sources.identified)
    # A link that leads nowhere, or a folder, is no reason to go on without what was measured.
    measured = [overlay] if sources.identified is not None or os.path.lexists(overlay) else []
    files = fingerprints(([path] if path is not None else []) + measured)  # before they are read
    calibration = _calibration(path, robot, settings) if path is not None else None
    for each in measured:
        robot = replace(robot, identified=load_identified(each, robot))
    if robot.gate.contact_hold_nm and robot.identified is None:
        raise InvalidInput(
            f"gate.contact.hold_nm of {robot.name} needs an identified model, and {overlay} is missing: run "
            "`twindctl identify` without the key, or name the file with --identified"
        )
    files[str(robot.path)] = robot.text_sha256
    files[str(robot.mjcf_path)] = hashlib.sha256(robot.mjcf.encode()).hexdigest()
    files |= {str(each.table.absolute()): each.table_sha256 for each in robot.transmissions if each.table}
    denied = live_denied(
        robot.name,
        ports,
        usual,
        calibrated=calibration is not None,
        open_items=() if sources.made_from_file else robot.todo,
    )
    if settings.mode == "live" and denied is not None:
        raise InvalidInput(denied.message)
    rate_hz = settings.rate_hz or robot.rate_hz
    if settings.mode != "sim":
        require_rate(robot, rate_hz)
    return LoadedConfig(settings, robot, ports, calibration, rate_hz, files, denied)


def _calibration(path: Path, robot: RobotFile, settings: DaemonSettings) -> Calibration:
    """Load the calibration. Raises ConfigError, with the way to a new one."""
    try:
        return load_calibration(path, robot)
    except ConfigError as error:
        if error.forbidden:
            raise
        message = f"{error.message}; {new_calibration(path, settings, absent=error.absent)}"
        mark = FilePosition(error.line, error.column)
        raise ConfigError(error.file, mark, error.path, message) from error.__cause__


def new_calibration(path: Path, settings: DaemonSettings, *, absent: bool) -> str:
    """Return how to make a calibration in place of one that is refused; a daemon must run for that.

    `absent`: no file is there.
    """
    without, option = "", ""
    if settings.calibration is not None:
        source = settings.origins.get("calibration", COMMAND_LINE)
        without = " without " + ("--calibration" if source == COMMAND_LINE else f"`calibration:` in {source}")
        option = f" --calibration {shlex.quote(str(path))}"
    first = "" if absent else f"{set_aside(path)}, "
    return (
        f"to make a new one: {first}start twind in mode mirror{without}, `twindctl calibrate sweep{option}`"
    )


def overlay_path(settings: DaemonSettings, robot_name: str, named: str | None = None) -> Path:
    """Return the path of the identified model, there or not: as `named`, else beside the calibration."""
    if named is not None:
        return Path(named)
    return identified_path(settings.calibration or settings.usual_calibration(robot_name))


def bus_ports(
    settings: DaemonSettings, buses: Sequence[str], described: Mapping[str, str | None]
) -> dict[str, str | None]:
    """The port of each bus: the command line over the settings over the robot file. Raises UsageError."""
    ports = dict(described) | {name: port for name, port in settings.ports.items() if name}
    unknown = set(ports) - set(buses)
    if unknown:
        raise InvalidInput(f"no bus {sorted(unknown)[0]!r}; the buses of this robot: {', '.join(buses)}")
    bare = settings.ports.get("")
    if bare is not None:
        if len(buses) != 1:
            named = " ".join(f"--port {bus}=PORT" for bus in buses)
            raise InvalidInput(f"--port {bare}: this robot has {len(buses)} buses, say which: {named}")
        ports[buses[0]] = bare
    found = {name: _absolute(port) for name, port in ports.items()}
    if settings.ports or settings.mode != "sim":
        _refuse_shared(found)
    return found


def _refuse_shared(ports: Mapping[str, str | None]) -> None:
    """Refuse two buses on one port, whatever names or links of it they have."""
    owners: dict[str, str] = {}
    for bus, port in ports.items():
        if port is not None:
            first = owners.setdefault(os.path.realpath(port), bus)
            if first != bus:
                raise InvalidInput(f"buses {first} and {bus} have the same port {port}: give each its own")


def _absolute(port: str | None) -> str | None:
    """Return a serial port by its absolute path, valid in every folder; links such as by-id names stay."""
    return port if not port or port.startswith(SCHEME) else os.path.abspath(port)


def refuse_wrong(robot: RobotFile, ports: Mapping[str, str | None]) -> None:
    """Raises UsageError for a serial port of a CAN bus, or the other way round."""
    for name, port in ports.items():
        kind = robot.bus(name).kind
        wrong = None if port is None else wrong_port(family(kind).medium, port, kind)
        if wrong is not None:
            raise InvalidInput(f"port of bus {name}: {wrong}")


def live_denied(
    robot: str,
    ports: Mapping[str, str | None],
    usual: Path,
    *,
    calibrated: bool,
    open_items: Sequence[str] = (),
) -> Finding | None:
    """Why this daemon may not write to this robot; None: it may. `usual`: where a calibration is sought.

    `open_items`: keys of the robot file that are not settled.
    """
    if open_items:
        named = ", ".join(open_items[:SHOWN_ITEMS])
        more = f" and {len(open_items) - SHOWN_ITEMS} more" if len(open_items) > SHOWN_ITEMS else ""
        message = (
            f"mode live needs a settled robot file; `todo` of {robot} has {named}{more}; settle them with "
            "`twindctl robot finish`"
        )
        return Finding(ReasonCode.ROBOT_UNFINISHED, message=message)
    missing = [bus for bus, port in ports.items() if port is None]
    if missing:
        message = f"mode live needs a port for bus {missing[0]!r}: --port {missing[0]}=PORT"
        return Finding(ReasonCode.HW_DISCONNECTED, message=message)
    if not calibrated:
        message = (
            f"mode live needs a calibration of {robot}: none at {usual}, and none named with "
            f"--calibration FILE; how to make one: {page(CALIBRATION)}"
        )
        return Finding(ReasonCode.CALIB_MISSING, message=message)
    return None
