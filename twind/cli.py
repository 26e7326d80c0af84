"""`twind`: the daemon. Reads the files, opens the sockets, builds the loop and runs it in this process."""

import argparse
import faulthandler
import os
import signal
import socket
import sys
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from types import FrameType

from twind.config.budget import require_rate
from twind.config.calibration_file import load_calibration
from twind.config.edited import fingerprints
from twind.config.located import ConfigError
from twind.config.ports import virtual_port, wrong_port
from twind.config.robot_file import RobotFile, load_robot
from twind.config.settings import Settings, load_settings
from twind.loop import assembly, realtime
from twind.loop.notify import Notifier
from twind.loop.open_bus import Buses
from twind.loop.sockets import GROUPS, NAMES, SocketError, group_of, handed_over, listen
from twind.loop.tick import Loop
from twind.loop.virtual_child import VirtualChild, VirtualError
from twind.robot.finding import Code, Finding
from twind.robot.modes import Mode
from twind.safety.gate import Thresholds
from twind.twin.binding import BindingError, bind
from twind.version import __version__
from twind_drivers.bus import PortError
from twind_drivers.clock import MonotonicClock

FAILED, USAGE = 1, 2
LOWERING = 30.0  # s the service manager is asked for: two ways to the rest pose, coming to rest, an e-stop


def parser() -> argparse.ArgumentParser:
    """The options of design 6.2."""
    result = argparse.ArgumentParser(
        prog="twind", description="Owns a robot's buses and lets nothing unchecked reach a servo."
    )
    result.add_argument("--version", action="version", version=f"twind {__version__}")
    result.add_argument(
        "--config", metavar="FILE", help="settings (default /etc/twind/twind.yaml when it is there)"
    )
    result.add_argument("--mode", choices=[mode.value for mode in Mode], help="sim, mirror (default) or live")
    result.add_argument("--robot", metavar="NAME|FILE", help="built-in robot or robot file (default h24)")
    result.add_argument("--calibration", metavar="FILE", help="calibration of this individual")
    result.add_argument(
        "--port",
        metavar="PORT|BUS=PORT",
        action="append",
        default=[],
        help="serial port, or can:slcan:PATH, can:socketcan:can0; BUS=PORT for each bus of several",
    )
    result.add_argument("--socket", metavar="DIR", help="folder of the control sockets")
    result.add_argument(
        "--rate", metavar="HZ", type=float, help="exchanges per second, 10 to 1000 (default 100)"
    )
    result.add_argument(
        "--virtual", action="store_true", help="start virtual servos of the same robot and connect to them"
    )
    return result


def main(arguments: list[str] | None = None) -> int:
    """Run the daemon until it is told to end. Exit code 0: ended as asked; 1: failed; 2: usage or files."""
    faulthandler.enable()
    options = parser().parse_args(arguments)
    try:
        with ExitStack() as stack:
            return _serve(options, stack)
    except (ConfigError, BindingError, UsageError) as error:
        print(f"twind: {error}", file=sys.stderr)
        return USAGE
    except (PortError, SocketError, VirtualError) as error:
        print(f"twind: {error}", file=sys.stderr)
        return FAILED


class UsageError(Exception):
    """The command line and the files do not go together."""


def _serve(options: argparse.Namespace, stack: ExitStack) -> int:
    inherited = handed_over()  # before any child: LISTEN_* is not for it
    for listener in inherited.values():
        stack.callback(listener.close)
    settings = _settings(options)
    robot = load_robot(settings.robot, settings.robot_folders)
    ports = bus_ports(
        settings, [bus.name for bus in robot.buses], {bus.name: bus.port for bus in robot.buses}
    )
    refuse_wrong(robot, ports)
    calibration_path = settings.calibration_path(robot.name)
    if options.virtual and (options.port or options.calibration):
        raise UsageError("--virtual brings its own port and calibration: leave out --port and --calibration")
    if options.virtual:
        child = stack.enter_context(VirtualChild(settings.robot))
        ports = {name: virtual_port(robot.bus(name).kind, path) for name, path in child.ports.items()}
        calibration_path = child.calibration
    mode = Mode(settings.mode)
    files = fingerprints([calibration_path] if calibration_path is not None else [])  # before it is read
    calibration = load_calibration(calibration_path, robot) if calibration_path is not None else None
    denied = live_denied(robot.name, ports, calibration is not None)
    if mode is Mode.LIVE and denied is not None:
        raise UsageError(denied.message)
    rate_hz = settings.rate_hz or robot.rate_hz
    if mode is not Mode.SIM:
        require_rate(robot, rate_hz)
    one = assembly.Robot(robot, calibration, bind(robot, calibration))
    sockets = {name: inherited.get(name) or listen(settings.socket_dir, name) for name in NAMES}
    for listener in sockets.values():
        stack.callback(listener.close)
    buses = Buses(robot, one.binding.joint_map, ports, rate_hz)
    if mode is not Mode.SIM:
        buses.refuse_taken()
    files |= fingerprints([robot.path, robot.mjcf_path])
    briefing = assembly.brief(one, rate_hz, settings.parameters(), settings.log_level, files)
    notifier = Notifier()
    stack.callback(notifier.close)
    loop = assembly.build(
        one,
        mode=mode,
        rate_hz=rate_hz,
        clock=MonotonicClock(),
        where=ports,
        opener=buses.open,
        enabler=buses.enable,
        link=assembly.front(briefing, sockets["control"], sockets["observe"]),
        notifier=notifier,
        thresholds=Thresholds(
            latency_warn=settings.latency_warn_ms / 1e3, latency_block=settings.latency_block_ms / 1e3
        ),
        realtime=realtime.enter(cpu=settings.cpu),
        live_denied=denied,
    )
    return run(loop, notifier, sockets)


def run(loop: Loop, notifier: Notifier, sockets: Mapping[str, socket.socket]) -> int:
    """Tick until told to end. A second signal does not cut the settling short."""

    def stop(number: int, frame: FrameType | None) -> None:
        notifier.send(STOPPING="1", EXTEND_TIMEOUT_USEC=f"{LOWERING * 1e6:.0f}")
        loop.stop_wanted = True

    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, stop)
    signal.signal(signal.SIGPIPE, signal.SIG_IGN)
    where = ", ".join(f"{port.name} on {port.where or 'no port'}" for port in loop.hardware.ports)
    groups = {name: group_of(listener) for name, listener in sockets.items()}
    said = f"twind {__version__}, mode {loop.mode.value}, {1 / loop.period:g} Hz, {where}; "
    said += ", ".join(f"{name} socket for group {group or 'unknown'}" for name, group in groups.items())
    loop.say.event("info", "START", said)
    if os.geteuid() == 0:
        for warning in wrong_groups(groups):
            loop.say.event("warning", "START", warning)
    try:
        loop.run()
    finally:
        loop.close()
    return 0


def wrong_groups(groups: Mapping[str, str]) -> list[str]:
    """What to tell of each socket that did not get the group that is meant to use it."""
    return [
        f"{name}.sock is for group {group or 'unknown'}, not {GROUPS[name]}: members of that cannot use it; "
        f"`groupadd -r {GROUPS[name]}` and start twind again"
        for name, group in groups.items()
        if group != GROUPS[name]
    ]


def _settings(options: argparse.Namespace) -> Settings:
    settings = load_settings(Path(options.config) if options.config else None)
    return settings.override(
        mode=options.mode,
        robot=options.robot,
        calibration=options.calibration,
        socket=options.socket,
        rate_hz=options.rate,
        ports=options.port,
    )


def bus_ports(
    settings: Settings, buses: list[str], described: Mapping[str, str | None]
) -> dict[str, str | None]:
    """The port of each bus: the command line over the settings over the robot file. Raises UsageError."""
    ports = dict(described) | {name: port for name, port in settings.ports.items() if name}
    unknown = set(ports) - set(buses)
    if unknown:
        raise UsageError(f"no bus {sorted(unknown)[0]!r}; the buses of this robot: {', '.join(buses)}")
    bare = settings.ports.get("")
    if bare is not None:
        if len(buses) != 1:
            named = " ".join(f"--port {bus}=PORT" for bus in buses)
            raise UsageError(f"--port {bare}: this robot has {len(buses)} buses, say which: {named}")
        ports[buses[0]] = bare
    return ports


def refuse_wrong(robot: RobotFile, ports: Mapping[str, str | None]) -> None:
    """Raises UsageError for a serial port of a CAN bus, or the other way round."""
    for name, port in ports.items():
        wrong = None if port is None else wrong_port(robot.bus(name).kind, port)
        if wrong is not None:
            raise UsageError(f"port of bus {name}: {wrong}")


def live_denied(robot: str, ports: Mapping[str, str | None], calibrated: bool) -> Finding | None:
    """Why this daemon may not write to this robot; None: it may."""
    missing = [bus for bus, port in ports.items() if port is None]
    if missing:
        message = f"mode live needs a port for bus {missing[0]!r}: --port {missing[0]}=PORT"
        return Finding(Code.HW_DISCONNECTED, message=message)
    if not calibrated:
        message = f"mode live needs a calibration of {robot}: start the daemon with --calibration FILE"
        return Finding(Code.CALIB_MISSING, message=message)
    return None


if __name__ == "__main__":
    sys.exit(main())
