"""`twind`: the daemon. Reads the files, opens the sockets, builds the loop and runs it in this process."""

import argparse
import faulthandler
import os
import signal
import sys
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from types import FrameType

from twind.briefing import fingerprint
from twind.config.config_files import ConfigSources, LoadedConfig, describe, pack
from twind.config.daemon_settings import DaemonSettings
from twind.config.driver_family import family
from twind.config.port_names import virtual_port
from twind.config.robot_file import load_robot
from twind.config.yaml_tree import ConfigError
from twind.exceptions import InvalidInput, OperationFailed, TwindError
from twind.flight import copy
from twind.front import reserved_descriptors
from twind.front.flight_folder import FAILSAFE, FlightFolder, meta_of, plain
from twind.listening_sockets import GROUPS, NAMES, Listener, group_of, listen
from twind.loop.bus import bus_tap
from twind.loop.bus.bus_opener import BusOpener
from twind.loop.bus.bus_tap import FlightRecorder
from twind.loop.ipc import descriptors
from twind.loop.ipc.former_flight_recorder import FormerFlightRecorder
from twind.loop.ipc.front_link import ControlLink
from twind.loop.ipc.inherited_descriptors import WRECK, InheritedDescriptors, handed_over
from twind.loop.procedures.failsafe import FailsafeRun, HeadlessLink
from twind.loop.process import realtime
from twind.loop.process.hangup_signal import HangupSignal
from twind.loop.process.power_child import PowerChild
from twind.loop.process.service_notify import Notifier
from twind.loop.process.virtual_robot_process import VirtualRobotProcess
from twind.loop.tick import assembly
from twind.loop.tick.bound_robot import BoundRobot
from twind.loop.tick.control_loop import Loop
from twind.robot.event_codes import EventCode
from twind.robot.modes import Mode
from twind.safety.gate import GateThresholds
from twind.standard_streams import lines, stand_in_for_closed, write_line
from twind.twin.binding import bind
from twind.version import __version__
from twind_drivers.bus import PortError, PortErrorCause
from twind_drivers.clock import MonotonicClock

FAILED = 1
USAGE = 2
TAKEN = 3
LOWERING = 30.0  # s the service manager is asked for: two ways to the rest pose, coming to rest, an e-stop
ENDING = 10.0  # s it is asked for once the loop has ended: ports are closed, the front ends
STARTING = (
    60.0  # s it is asked for before READY: a large model on a small machine, ports that are slow to open
)
LEFT = (
    "the robot is left as it is: what had torque keeps it, where its servos' own watchdogs stopped it; "
    "support it and switch its power off, or mend this, start twind and `twindctl disarm`"
)


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    result = argparse.ArgumentParser(
        prog="twind", description="Own a robot's buses and check every command to its actuators."
    )
    result.add_argument("--version", action="version", version=f"twind {__version__}")
    result.add_argument(
        "--config",
        metavar="FILE",
        help="settings (default: /etc/twind/twind.yaml as root, else ~/.config/twind/twind.yaml)",
    )
    result.add_argument("--mode", choices=[mode.value for mode in Mode], help="sim, mirror (default) or live")
    result.add_argument("--robot", metavar="NAME|FILE", help="built-in robot or robot file (default h24)")
    result.add_argument("--calibration", metavar="FILE", help="calibration of this individual")
    result.add_argument(
        "--identified",
        metavar="FILE",
        help="identified model (default: NAME.identified.yaml beside the calibration)",
    )
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
    result.add_argument(
        "--failsafe",
        action="store_true",
        help="after a daemon has failed: lower its robot, switch torque off, end (docs/safety.md)",
    )
    return result


def main(arguments: list[str] | None = None) -> int:
    """Run the daemon until it is asked to end. Exit code 0: ended as asked; 1: failed; 2: usage or files.

    With `--failsafe` 0: torque is off everywhere; 1: it is left on, or not known; 2: usage or files, nothing
    was written; 3: another process has a port, nothing was written.
    """
    stand_in_for_closed()
    faulthandler.enable(2)
    options = parser().parse_args(arguments)
    code, why = FAILED, ""
    try:
        with ExitStack() as stack:
            code = _lower(options, stack) if options.failsafe else _serve(options, stack)
    except (ConfigError, InvalidInput) as error:
        code, why = USAGE, f"twind: {error}"
    except (PortError, OperationFailed) as error:
        in_use = isinstance(error, PortError) and error.kind is PortErrorCause.IN_USE
        code, why = TAKEN if options.failsafe and in_use else FAILED, f"twind: {error}"
    finally:  # also before the traceback of a defect
        if options.failsafe and code not in (0, TAKEN):
            why = f"{why}\ntwind --failsafe: {LEFT}".lstrip()
        if why:
            print(lines(2, "error", why), file=sys.stderr)
    return code


def _serve(options: argparse.Namespace, stack: ExitStack) -> int:
    hang_ups = HangupSignal()  # before all that takes time
    inherited = handed_over()  # before any child: LISTEN_* is not for it
    stack.callback(inherited.close)
    wreck = FormerFlightRecorder(inherited.wreck)
    stack.callback(wreck.close)
    sources = _sources(options)
    virtual = None
    if options.virtual:
        sources, virtual = _with_virtual(sources, stack)
    described = describe(sources)
    settings = described.settings
    robot = described.robot
    mode = Mode(described.settings.mode)
    raised = descriptors.ensure(descriptors.needed(len(robot.buses), reserved_descriptors.NEEDED))
    if raised:
        write_line(2, "info", f"twind: {raised}")
    notifier = Notifier()
    stack.callback(notifier.close)
    notifier.send(STATUS=f"starting: the model of {robot.name} is compiled")
    notifier.extend(STARTING)
    one, buses = _made(described)
    listeners = {name: _listener(inherited, settings.socket_dir, name) for name in NAMES}
    for listener in listeners.values():
        stack.callback(listener.remove)
    if mode is not Mode.SIM:
        buses.refuse_taken()
    briefing = assembly.make_briefing(
        one,
        described.rate_hz,
        settings.parameters(),
        settings.log_level,
        described.files,
        pack(sources, described),
    )
    recorder = bus_tap.recorder(described.robot, described.rate_hz, MonotonicClock())
    if recorder is not None:
        recorder.sign(fingerprint(__version__, described.files))
    folder = flight_folder(settings, virtual=options.virtual)
    link = assembly.front(briefing, listeners, recorder, folder, wreck)
    stack.callback(link.front.close)
    power = assembly.power(robot, described.rate_hz, {} if virtual is None else virtual.power)
    loop = _loop(described, one, buses, link, notifier, recorder, power, virtual)

    def keep() -> None:
        """Store this daemon's recorder with the service manager, in place of a former daemon's."""
        notifier.drop(WRECK) if recorder is None else notifier.store(WRECK, recorder.fd)

    wreck.then = keep  # until then the store holds the former recording: it may not be written yet
    if wreck.fd is None:
        keep()
    run(loop, notifier, listeners, hang_ups)
    if link.front.ended_well and wreck.fd is None:  # it has written what there was to write
        notifier.drop(WRECK)
    return 0


def _listener(inherited: InheritedDescriptors, folder: Path, name: str) -> Listener:
    """Return the service manager's socket of that name, else a new one. Raises OperationFailed."""
    given = inherited.sockets.get(name)
    if given is not None:
        return Listener.of(given, own=False)
    return Listener.of(listen(folder, name), own=True)


def _lower(options: argparse.Namespace, stack: ExitStack) -> int:
    """Run `--failsafe`: the loop without sockets and front, until torque is off or it is left on."""
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    if options.virtual:
        raise InvalidInput("--failsafe is for a robot that is there: leave out --virtual")
    described = describe(_sources(options))
    mode = described.settings.mode
    ports = described.ports
    if mode == "sim" or not any(ports.values()):
        print(f"twind --failsafe: mode {mode} without a port: there is no robot to lower", file=sys.stderr)
        return 0
    one, buses = _made(described)
    buses.refuse_taken()
    notifier = Notifier()
    stack.callback(notifier.close)
    recorder = bus_tap.recorder(described.robot, described.rate_hz, MonotonicClock())
    aloud = HeadlessLink(2, None if recorder is None else recorder.link)
    loop = _loop(described, one, buses, aloud, notifier, recorder)
    failsafe = FailsafeRun(loop, loop.identity, loop.commands.release, notifier)

    def stop(number: int, frame: FrameType | None) -> None:  # not as a daemon ends, which lowers any robot
        failsafe.stop()

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, stop)
    signal.signal(signal.SIGPIPE, signal.SIG_IGN)
    loop.reports.event("info", EventCode.START, f"twind {__version__} --failsafe, {start_text(loop)}")
    if recorder is not None:  # also after an exception
        stack.callback(save_failsafe_recording, described, one, recorder, mode)
    stack.callback(loop.close)
    failsafe.begin()
    run_loop(loop)
    return FAILED if failsafe.left else 0


def _made(described: LoadedConfig) -> tuple[BoundRobot, BusOpener]:
    """Return the robot of these files, and its buses; nothing is opened. Raises InvalidInput."""
    robot = described.robot
    one = BoundRobot(robot, described.calibration, bind(robot, described.calibration))
    return one, BusOpener(robot, one.binding.joint_map, described.ports, described.rate_hz)


def flight_folder(settings: DaemonSettings, *, virtual: bool = False) -> Path:
    """Return the folder of flight recordings. A virtual or simulated robot replaces none of a real one."""
    folder = settings.state_dir.absolute() / "flight"
    if virtual:
        return folder / "virtual"
    return folder / "sim" if settings.mode == "sim" else folder


def save_failsafe_recording(
    described: LoadedConfig, one: BoundRobot, recorder: FlightRecorder, mode: str
) -> None:
    """Write the recording of a fail-safe run: torque is off by now, or the robot left as it is.

    It is not urgent, and its failure changes nothing in the report about the robot.
    """
    realtime.drop_realtime()
    settings = described.settings
    folder = FlightFolder(flight_folder(settings))
    try:
        briefing = assembly.briefing(one, described.rate_hz, settings.parameters(), files=described.files)
        meta = meta_of(briefing, "failsafe", FAILSAFE, mode)
        path = folder.write(FAILSAFE, meta, plain(briefing), copy(recorder.fd))
        write_line(2, "info", f"twind --failsafe: what was done is written down in {path}")
    except Exception as error:  # noqa: BLE001 - the robot is down, or left, whatever breaks here
        write_line(2, "warning", f"twind --failsafe: what was done could not be written down: {error!r}")


def _loop(
    described: LoadedConfig,
    one: BoundRobot,
    buses: BusOpener,
    link: ControlLink,
    notifier: Notifier,
    recorder: FlightRecorder | None,
    power: PowerChild | None = None,
    virtual: VirtualRobotProcess | None = None,
) -> Loop:
    settings = described.settings
    if recorder is not None:
        buses = replace(buses, tapes=recorder.tapes)
    return assembly.build(
        one,
        mode=Mode(settings.mode),
        rate_hz=described.rate_hz,
        clock=MonotonicClock(),
        where=described.ports,
        opener=buses.open if virtual is None else virtual.guarded(buses.open),
        enabler=buses.enable,
        link=link,
        notifier=notifier,
        thresholds=GateThresholds(
            latency_warn=settings.latency_warn_ms / 1e3, latency_block=settings.latency_block_ms / 1e3
        ),
        realtime=realtime.enter(cpu=settings.cpu),
        live_denied=described.live_denied,
        rewire=lambda robot: replace(buses, robot=robot.file, joints=robot.binding.joint_map).enable,
        tapes=buses.tapes,
        power=power,
    )


def run_loop(loop: Loop) -> None:
    """Run the loop until it ends.

    An error of a running loop is a defect, no wrong setting and no port in use. It must not end the process
    with their exit codes: after 2 the service manager does not restart it.
    """
    _kept = realtime.touch_reserve()
    try:
        loop.run()
    except TwindError as error:
        raise RuntimeError(f"defect in the loop: {error}") from error


def run(loop: Loop, notifier: Notifier, listeners: Mapping[str, Listener], hang_ups: HangupSignal) -> None:
    """Tick until a signal. A second signal does not cut the settling short."""

    def end() -> None:
        notifier.send(STOPPING="1", EXTEND_TIMEOUT_USEC=f"{LOWERING * 1e6:.0f}")
        loop.condition.stop_wanted = True

    def stop(number: int, frame: FrameType | None) -> None:
        end()

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, stop)
    signal.signal(signal.SIGPIPE, signal.SIG_IGN)
    hang_ups.enable_delivery(reread=loop.commands.reloads.want, end=end)
    groups = {name: group_of(listener.bound) for name, listener in listeners.items()}
    sockets = ", ".join(f"{name} socket for group {group or 'unknown'}" for name, group in groups.items())
    loop.reports.event("info", EventCode.START, f"twind {__version__}, {start_text(loop)}; {sockets}")
    for what, got in loop.parts.realtime.items():
        if not got.granted:
            loop.reports.event("warning", EventCode.START, f"not as real time wants it: {what} {got.text}")
    if os.geteuid() == 0:
        for warning in wrong_groups(groups):
            loop.reports.event("warning", EventCode.START, warning)
    try:
        run_loop(loop)
    finally:
        # However it ends: the watchdog is fed no longer, and the front has some seconds for its last words.
        notifier.send(STOPPING="1", EXTEND_TIMEOUT_USEC=f"{ENDING * 1e6:.0f}")
        loop.close()


def start_text(loop: Loop) -> str:
    """Return mode, rate and ports for the event START."""
    mode = loop.condition.mode
    none = "no port" + ("" if mode is Mode.SIM else ": start it with --port {}=PORT, or with --virtual")
    where = ", ".join(
        f"{port.name} on {port.where or none.format(port.name)}" for port in loop.hardware.ports
    )
    return f"mode {mode.value}, {1 / loop.parts.period:g} Hz, {where}"


def wrong_groups(groups: Mapping[str, str]) -> list[str]:
    """Return a warning for each socket whose group is not the intended one."""
    return [
        f"{name}.sock is for group {group or 'unknown'}, not {GROUPS[name]}: members of that cannot use it; "
        f"`groupadd -r {GROUPS[name]}` and start twind again"
        for name, group in groups.items()
        if group != GROUPS[name]
    ]


def _sources(options: argparse.Namespace) -> ConfigSources:
    if options.virtual and (options.port or options.calibration):
        raise InvalidInput(
            "--virtual brings its own port and calibration: leave out --port and --calibration"
        )
    return ConfigSources(
        config=options.config,
        mode=options.mode,
        robot=options.robot,
        calibration=options.calibration,
        identified=options.identified,
        socket=options.socket,
        rate_hz=options.rate,
        ports=tuple(options.port),
    )


def _with_virtual(sources: ConfigSources, stack: ExitStack) -> tuple[ConfigSources, VirtualRobotProcess]:
    """Start virtual servos of the same robot; their ports and calibration replace all others."""
    settings = sources.settings()
    robot = load_robot(settings.robot, settings.robot_folders)
    child = stack.enter_context(VirtualRobotProcess(settings.robot))
    write_line(2, "info", f"twind: the virtual robot takes orders (hand, push, faults) at {child.faults}")
    ports = [
        f"{name}={virtual_port(family(robot.bus(name).kind).medium, path)}"
        for name, path in child.ports.items()
    ]
    found = replace(sources, calibration=str(child.calibration), ports=tuple(ports), made_from_file=True)
    return found, child


if __name__ == "__main__":
    sys.exit(main())
