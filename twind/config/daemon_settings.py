"""Settings of the daemon, `twind.yaml`: file first, then the command line over it. Unknown keys are errors.

Root uses /etc, /var/lib and /run; other users the folders of the XDG variables.
"""

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Literal, get_args

import msgspec
from msgspec import Meta

from twind.config.config_reader import ConfigReader, ConfigStruct, Name, Text, file_error
from twind.config.port_names import wrong_port
from twind.config.yaml_tree import parse, read_text
from twind.protocol.socket_paths import own_folder

Mode = Literal["sim", "mirror", "live"]
Level = Literal["debug", "info", "warning", "error"]
MODES: tuple[str, ...] = get_args(Mode)
LEVELS: tuple[str, ...] = get_args(Level)
# A file may only tighten them.
LATENCY_WARN_MS = 50.0
LATENCY_BLOCK_MS = 100.0
COMMAND_LINE = "command line"

_NAME = re.compile(r"[a-z0-9_-]{1,64}")
_PER_BUS = re.compile(r"([A-Za-z0-9][A-Za-z0-9_.-]*)=(.+)")


class LatencyThresholdKeys(ConfigStruct):
    """Section `thresholds` of the settings: latencies in ms."""

    latency_warn_ms: Annotated[float, Meta(gt=0.0, le=LATENCY_WARN_MS)] = LATENCY_WARN_MS
    """a higher latency is reported"""
    latency_block_ms: Annotated[float, Meta(gt=0.0, le=LATENCY_BLOCK_MS)] = LATENCY_BLOCK_MS
    """≥ `latency_warn_ms`, ≤100 | | a higher latency refuses motion and arming"""


class SettingsKeys(ConfigStruct):
    """Keys of the settings file. A path is relative to the file, but for `sockets` and `state_dir`."""

    mode: Mode = "mirror"
    """see [safety](safety.md#modes); no mode arms by itself"""
    robot: Text = "h24"
    """name or file | | searched in `robots/` beside the settings, then among the built-in robots"""
    individual: Name | None = None
    """| the robot's name | name of this robot; selects its calibration"""
    calibration: Text | None = None
    """file | the individual's | calibration to load instead"""
    ports: dict[str, Text] = msgspec.field(default_factory=dict)
    """`BUS: PORT` | | port of each bus: a serial path or a [CAN port](#can-buses). Prefer
    `/dev/serial/by-id/…`"""
    rate_hz: Annotated[float, Meta(ge=10.0, le=1000.0)] | None = None
    """| the robot file's | ticks per second; arming needs at least 20"""
    sockets: Text | None = None
    """folder | `/run/twind`, else `$XDG_RUNTIME_DIR/twind` | folder of the control sockets"""
    state_dir: Text | None = None
    """folder | `/var/lib/twind`, else `~/.local/state/twind` | calibrations, and [flight
    recordings](observe.md) in `flight/`"""
    thresholds: LatencyThresholdKeys = msgspec.field(default_factory=LatencyThresholdKeys)
    log_level: Level = "info"
    """lowest level in the log"""
    gap: bool = True
    """whether the [gap](gap.md) between robot and simulation is worked out in mode live"""
    cpu: Annotated[int, Meta(ge=0, le=1023)] | None = None
    """| any | CPU core of the loop"""


VIRTUAL_FOLDER = "twind-virtual-"  # a temporary folder of `twind --virtual`, with its calibration, begins so


@dataclass(frozen=True, slots=True)
class InstallationPaths:
    """The folders of one installation."""

    config: Path
    state: Path
    sockets: Path


@dataclass(frozen=True, slots=True)
class DaemonSettings:
    """Settings of the daemon. Paths are absolute or relative to the folder of its start."""

    mode: str
    robot: str  # name or path
    individual: str | None  # whose calibration; None: the robot's name
    calibration: Path | None  # None: the individual's, below `state_dir`
    ports: Mapping[str, str]  # by bus; "" is a port given without a bus, for robots that have one
    rate_hz: float | None  # None: as the robot file says
    socket_dir: Path
    state_dir: Path
    robot_folders: tuple[Path, ...]  # where a robot is looked up by name, before the built-in ones
    latency_warn_ms: float
    latency_block_ms: float
    log_level: str
    gap: bool = True  # the gap is worked out in mode live
    cpu: int | None = None  # the core that the loop stays on, as the kernel counts them; None: any
    source: str = field(default="defaults")  # the file they came from
    # Key of the file -> where its value comes from: the file, or the command line; not named: the default.
    origins: Mapping[str, str] = field(default_factory=dict)

    def override(
        self,
        *,
        mode: str | None = None,
        robot: str | None = None,
        calibration: str | None = None,
        socket: str | None = None,
        rate_hz: float | None = None,
        ports: Sequence[str] = (),
    ) -> "DaemonSettings":
        """The same with what the command line gives; None and () leave what is there. Raises ConfigError."""
        if mode is not None and mode not in MODES:
            raise file_error(COMMAND_LINE, f"--mode {mode} is none of {', '.join(MODES)}")
        if rate_hz is not None and not 10.0 <= rate_hz <= 1000.0:
            raise file_error(COMMAND_LINE, f"--rate {rate_hz:g} is outside 10 to 1000 Hz")
        given: dict[str, object] = {
            "mode": mode,
            "robot": robot,
            "calibration": calibration,
            "sockets": socket,
        }
        given |= {"rate_hz": rate_hz, "ports": ports or None}
        origins = {key: COMMAND_LINE for key, value in given.items() if value is not None}
        return replace(
            self,
            origins={**self.origins, **origins},
            mode=mode or self.mode,
            robot=robot or self.robot,
            calibration=Path(calibration) if calibration else self.calibration,
            ports={**self.ports, **_command_line_ports(ports)},
            rate_hz=self.rate_hz if rate_hz is None else rate_hz,
            socket_dir=Path(socket) if socket else self.socket_dir,
        )

    def calibration_path(self, robot_name: str) -> Path | None:
        """The file to load; None where none was named and the individual has none yet."""
        if self.calibration is not None:
            return self.calibration
        path = self.usual_calibration(robot_name)
        return path if _is_there(path, "--calibration FILE") else None

    def usual_calibration(self, robot_name: str) -> Path:
        """Return the default path of the calibration of this individual."""
        return usual_calibration(self.state_dir, self.individual or robot_name)

    def parameters(self) -> dict[str, object]:
        """Return the reply of `GetParameters`; `origins` names the source of each key that is no default."""
        return {
            "mode": self.mode,
            "robot": self.robot,
            "individual": self.individual,
            "calibration": None if self.calibration is None else str(self.calibration.absolute()),
            "state_dir": str(self.state_dir.absolute()),
            "rate_hz": self.rate_hz,
            "latency_warn_ms": self.latency_warn_ms,
            "latency_block_ms": self.latency_block_ms,
            "log_level": self.log_level,
            "gap": self.gap,
            "cpu": self.cpu,
            "source": self.source,
            "origins": dict(self.origins),
        }


def usual_calibration(state_dir: Path, individual: str) -> Path:
    """Return the default path of the calibration of an individual."""
    return state_dir / "calibration" / f"{individual}.yaml"


def places(environ: Mapping[str, str], uid: int) -> InstallationPaths:
    """Return the folders of this user: configuration, state and sockets. STATE_DIRECTORY takes precedence."""
    if uid == 0:
        found = InstallationPaths(Path("/etc/twind"), Path("/var/lib/twind"), Path("/run/twind"))
    else:
        home = Path(environ.get("HOME") or "/")
        config = Path(environ.get("XDG_CONFIG_HOME") or home / ".config")
        state = Path(environ.get("XDG_STATE_HOME") or home / ".local/state")
        found = InstallationPaths(config / "twind", state / "twind", Path(own_folder(environ, uid)))
    if state_directory := environ.get("STATE_DIRECTORY"):
        found = replace(found, state=Path(state_directory.partition(":")[0]))
    return found


def load_settings(
    path: Path | None, environ: Mapping[str, str] | None = None, uid: int | None = None
) -> DaemonSettings:
    """Settings of `path`, which must be there; of the usual place where `path` is None, or else the defaults.

    Raises ConfigError.
    """
    where = places(os.environ if environ is None else environ, os.geteuid() if uid is None else uid)
    usual = where.config / "twind.yaml"
    if path is None and not _is_there(usual, "--config FILE"):
        return _settings(SettingsKeys(), where)
    file = usual if path is None else path
    return _read(read_text(file), str(file), where)


def _is_there(path: Path, option: str) -> bool:
    """False only where it is absent. Raises ConfigError where unknown; `option` names another file."""
    try:
        path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return False
    except OSError as error:
        reason = error.strerror or type(error).__name__
        remedy = f"let uid {os.geteuid()} enter its folder, or name another file with {option}"
        raise file_error(str(path), f"cannot be looked for: {reason}; {remedy}") from None
    return True


def _read(text: str, file: str, where: InstallationPaths) -> DaemonSettings:
    top = ConfigReader(file, parse(text, file))
    given = top.read(SettingsKeys)
    limits = given.thresholds
    if limits.latency_block_ms < limits.latency_warn_ms:
        message = f"{limits.latency_block_ms:g} is below latency_warn_ms, {limits.latency_warn_ms:g}"
        raise top.section("thresholds").refuse("latency_block_ms", message)
    for bus, port in given.ports.items():
        if (wrong := wrong_port(None, port)) is not None:
            raise top.section("ports").refuse(bus, wrong)
    folder = Path(file).parent
    keys = [*(key for key in top if key != "thresholds"), *top.section("thresholds")]
    settings = _settings(given, where)
    return replace(
        settings,
        robot=given.robot if _NAME.fullmatch(given.robot) else str(folder / given.robot),
        calibration=None if given.calibration is None else folder / given.calibration,
        robot_folders=tuple(dict.fromkeys((folder / "robots", *settings.robot_folders))),
        source=file,
        origins=dict.fromkeys(keys, file),
    )


def _settings(given: SettingsKeys, where: InstallationPaths) -> DaemonSettings:
    """The settings of these keys in this installation; files beside the settings are not yet resolved."""
    return DaemonSettings(
        mode=given.mode,
        robot=given.robot,
        individual=given.individual,
        calibration=None,
        ports=given.ports,
        rate_hz=given.rate_hz,
        socket_dir=Path(given.sockets or where.sockets),
        state_dir=Path(given.state_dir or where.state),
        robot_folders=(where.config / "robots",),
        latency_warn_ms=given.thresholds.latency_warn_ms,
        latency_block_ms=given.thresholds.latency_block_ms,
        log_level=given.log_level,
        gap=given.gap,
        cpu=given.cpu,
    )


def _command_line_ports(ports: Sequence[str]) -> dict[str, str]:
    found: dict[str, str] = {}
    for given in ports:
        match = _PER_BUS.fullmatch(given)
        bus, port = (match[1], match[2]) if match else ("", given)
        if not port:
            raise file_error(COMMAND_LINE, "--port is empty: give a device, or BUS=device")
        if (wrong := wrong_port(None, port)) is not None:
            raise file_error(COMMAND_LINE, f"--port {wrong}")
        if bus in found:
            again = f"for bus {bus} " if bus else ""
            raise file_error(COMMAND_LINE, f"--port is given {again}twice: {found[bus]} and {port}")
        found[bus] = port
    if "" in found and len(found) > 1:
        named = ", ".join(f"{bus}={port}" for bus, port in found.items() if bus)
        message = f"--port {found['']} names no bus beside --port {named}: give every port as BUS=PORT"
        raise file_error(COMMAND_LINE, message)
    return found
