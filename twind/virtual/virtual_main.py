"""Program `twind-virtual`: servos with the real protocol on pseudo-terminals, a robot's with MuJoCo physics.

Prints `bus NAME PATH` per bus, `power NAME PATH` for relay and stop button, then `ready`. Ends at end-of-file
on standard input when that is a pipe, on SIGTERM and on SIGINT.
"""

import argparse
import gc
import os
import signal
import stat
import sys
from collections.abc import Collection, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

from twind.config.identified_file import load_identified
from twind.config.robot_file import load_robot
from twind.config.robot_spec import RobotFile
from twind.config.yaml_tree import ConfigError
from twind.exceptions import InvalidInput, OperationFailed
from twind.loop.process import realtime
from twind.standard_streams import write_line
from twind.twin.base_pose import BASES, UPRIGHT
from twind.twin.base_support import BY_TORQUE, HOLDS, BaseSupport
from twind.virtual.bench_servos import bench, by_bus, servo
from twind.virtual.fault_commands import FaultCommandSocket
from twind.virtual.pty_port import VirtualPtyPort
from twind.virtual.robot_ground_truth import RobotGroundTruth, load_truth, random_truth
from twind.virtual.virtual_power import BUTTON, RELAY, VirtualPower
from twind.virtual.virtual_robot_spec import body_for, buses, make_spec, save
from twind.virtual.virtual_server import ServoClock, VirtualBusServer
from twind.virtual.virtual_twin import BusTiming, DeviceOptions
from twind_drivers.clock import MonotonicClock
from twind_drivers.virtual.faulty_byte_stream import SerialAdapter
from twind_drivers.virtual.servable_bus import ServableBus

PRIORITY = 30  # SCHED_FIFO: below the daemon's loop, whose servos these are


def parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="twind-virtual", description="Serve a virtual robot on pseudo-terminals."
    )
    parser.add_argument("--robot", metavar="NAME|FILE", help="robot file (default h24, without --servo)")
    parser.add_argument(
        "--servo",
        action="append",
        default=[],
        metavar="BUS:ID:MODEL[:FIRMWARE]",
        help="add a servo or CAN actuator to the robot, or without --robot serve it alone; may be repeated",
    )
    parser.add_argument(
        "--bus",
        action="append",
        default=[],
        metavar="NAME",
        help="serve only this bus of the robot; may be repeated",
    )
    parser.add_argument("--link", type=Path, metavar="DIR", help="keep symbolic links DIR/BUS to the ports")
    parser.add_argument(
        "--baud", type=int, metavar="N", help="baud rate of every servo, instead of the robot file's"
    )
    parser.add_argument("--return-delay", type=int, metavar="US", help="return delay of every servo, µs")
    parser.add_argument("--firmware", type=int, metavar="N", help="firmware of every servo")
    parser.add_argument(
        "--latency-timer", type=float, default=0.0, metavar="MS", help="latency timer of the adapter"
    )
    parser.add_argument(
        "--supply", type=float, metavar="V", help="supply of the servos (default: what the model is made for)"
    )
    parser.add_argument("--echo", action="store_true", help="the adapter echoes what the host sends")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="seed of all random numbers")
    parser.add_argument(
        "--no-wire-timing", action="store_true", help="answer at once, without the delay of the wire"
    )
    parser.add_argument(
        "--muscles",
        choices=("mujoco", "first-order"),
        default="mujoco",
        help="model of the motion (default mujoco)",
    )
    parser.add_argument(
        "--base-pose", choices=tuple(BASES), default=UPRIGHT, help="how the body's base is held"
    )
    parser.add_argument(
        "--hold",
        choices=HOLDS,
        default=BY_TORQUE,
        help="support of a free base: until the legs have torque, until a command releases it, or never",
    )
    _add_robot_files(parser)
    parser.add_argument("--faults", type=Path, metavar="SOCKET", help="accept fault commands on this socket")
    return parser


def _add_robot_files(parser: argparse.ArgumentParser) -> None:
    """Add files of one robot: what is true of it, and what is written for it."""
    parser.add_argument("--truth", type=Path, metavar="FILE", help="true values of this robot: YAML or JSON")
    parser.add_argument(
        "--truth-seed", type=int, metavar="N", help="draw the true values of this robot at random"
    )
    parser.add_argument(
        "--identified",
        type=Path,
        metavar="FILE",
        help="strength, friction and masses of this identified model",
    )
    parser.add_argument("--calibration", type=Path, metavar="FILE", help="write the matching calibration")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program. Exit code 0 at its end, 2 when it cannot be started as requested."""
    options = parser().parse_args(arguments)
    try:
        _check(options)
        clock = ServoClock(MonotonicClock())
        robot = None if options.servo and options.robot is None else load_robot(options.robot or "h24")
        if robot is not None and options.identified is not None:
            robot = replace(robot, identified=load_identified(options.identified, robot))
        virtual, crane = _buses(options, robot, clock.now())
        prepare_motors(virtual, options.supply)
        if options.link is not None:
            options.link.mkdir(parents=True, exist_ok=True)
        _serve(virtual, clock, options, crane, power_ports(robot, virtual))
    except (ConfigError, InvalidInput, OperationFailed, OSError) as error:
        print(f"twind-virtual: {error}", file=sys.stderr)
        return 2
    return 0


def _print_port(name: str, path: str) -> None:
    print(f"bus {name} {path}", flush=True)


def _check(options: argparse.Namespace) -> None:
    """Raises InvalidInput: a number that no adapter or servo can have."""
    if not 0.0 <= options.latency_timer <= 255.0:
        raise InvalidInput(f"--latency-timer {options.latency_timer}: it is 0..255 ms")
    if not 0 <= (options.firmware or 0) <= 255:
        raise InvalidInput(f"--firmware {options.firmware}: it is 0..255")
    if options.bus and options.robot is None and options.servo:
        raise InvalidInput("--bus needs --robot: servos alone have the buses that they name")
    if options.seed < 0:
        raise InvalidInput(f"--seed {options.seed}: it is 0 or more")
    if options.truth is not None and options.truth_seed is not None:
        raise InvalidInput("--truth and --truth-seed: a truth is given or drawn, not both")
    if (options.truth_seed or 0) < 0:
        raise InvalidInput(f"--truth-seed {options.truth_seed}: it is 0 or more")
    if options.servo and options.robot is None:
        for name in ("calibration", "identified", "truth", "truth_seed"):
            if getattr(options, name) is not None:
                raise InvalidInput(f"--{name.replace('_', '-')} needs --robot: servos alone have no joints")


def power_ports(robot: RobotFile | None, buses: Collection[str]) -> list[str]:
    """Return the ports of relay and button. Raises InvalidInput: a bus has the same name."""
    if robot is None:
        return []
    named = {RELAY: robot.relay, BUTTON: robot.stop_button}
    ports = [name for name, spec in named.items() if spec is not None]
    if taken := [name for name in ports if name in buses]:
        raise InvalidInput(f"bus {taken[0]}: the robot file describes a {taken[0]} too; rename the bus")
    return ports


def _buses(
    options: argparse.Namespace, robot: RobotFile | None, now: float
) -> tuple[dict[str, ServableBus], BaseSupport | None]:
    line = BusTiming(
        wire_timing=not options.no_wire_timing,
        adapter=SerialAdapter(echo=options.echo, latency=options.latency_timer * 1e-3),
        seed=options.seed,
    )
    if robot is None:
        named = [_servo(text, options, {}) for text in options.servo]
        return bench(named, line, baud=options.baud, now=now), None
    one = make_spec(
        robot,
        baud=options.baud,
        return_delay_us=options.return_delay,
        firmware=options.firmware,
        truth=_truth(robot, options),
    )
    rates = {bus.name: options.baud or bus.baud for bus in robot.buses}
    extra = by_bus([_servo(text, options, rates) for text in options.servo])
    body = None
    if options.muscles == "mujoco":
        body = body_for(one, base=options.base_pose, hold=options.hold, now=now)
    virtual = buses(one, physics=False, body=body, now=now, line=line, extra=extra)
    if options.calibration is not None:
        save(one, options.calibration)
    return _served(virtual, options), None if body is None else body.crane


def prepare_motors(virtual: dict[str, ServableBus], volts: float | None) -> None:
    """Set the supply, and report models whose motors are those of another. Raises InvalidInput."""
    for bus in virtual.values():
        try:
            if volts is not None:
                bus.faults.supply(volts)
        except ValueError as error:
            raise InvalidInput(f"--supply: {error}") from None
        for model, other in bus.motor_stand_ins().items():
            text = f"no motor figures are published for {model}: it is as strong as {other}"
            write_line(2, "warning", f"twind-virtual: {text}")


def _truth(robot: RobotFile, options: argparse.Namespace) -> RobotGroundTruth | None:
    """Return the truth: random, from a file, or None: all is as described. Raises ConfigError."""
    if options.truth_seed is not None:
        return random_truth(robot, options.truth_seed)
    return None if options.truth is None else load_truth(options.truth, robot)


def _served(virtual: dict[str, ServableBus], options: argparse.Namespace) -> dict[str, ServableBus]:
    """Return the requested buses; all without a request. Raises InvalidInput."""
    unknown = [name for name in options.bus if name not in virtual]
    if unknown:
        raise InvalidInput(f"--bus {unknown[0]}: there are {', '.join(virtual)}")
    if options.bus and options.muscles == "mujoco" and set(options.bus) != set(virtual):
        raise InvalidInput("--bus: one body has one process; give --muscles first-order")
    return {name: bus for name, bus in virtual.items() if not options.bus or name in options.bus}


def _servo(text: str, options: argparse.Namespace, rates: Mapping[str, int]) -> tuple[str, Any]:
    """Bus and device of `--servo`, at the rate of its bus. Raises InvalidInput."""
    rate = rates.get(text.partition(":")[0], options.baud)
    return servo(text, DeviceOptions(options.firmware, rate, options.return_delay))


def _serve(
    virtual: dict[str, ServableBus],
    clock: ServoClock,
    options: argparse.Namespace,
    support: BaseSupport | None,
    power: Sequence[str],
) -> None:
    links = {name: options.link and options.link / name for name in (*virtual, *power)}
    with ExitStack() as undo:
        ports = {}
        for name, link in links.items():
            ports[name] = VirtualPtyPort(name, link)
            undo.callback(ports[name].close)
        beside = {name: ports.pop(name) for name in power}
        server = VirtualBusServer(virtual, ports, clock, _print_port, support)
        if beside:
            server.power = VirtualPower(beside, server.switch_supply, MonotonicClock())
        if options.faults is not None:
            server.orders = FaultCommandSocket(options.faults, server.execute_fault_command)
            undo.callback(server.orders.close)
        _wait_for_stop(server)
        for name, port in ports.items():
            _print_port(name, port.path)
        for name, port in beside.items():
            print(f"power {name} {port.path}", flush=True)
        print("ready", flush=True)
        realtime.one_thread()
        realtime.fifo(PRIORITY)  # servos reply in time on a busy machine, where permitted
        gc.freeze()  # permanent objects: a collection between two packets need not visit them
        server.run()


def _wait_for_stop(server: VirtualBusServer) -> None:
    """Set `ended` at SIGTERM, SIGINT or, where standard input is a pipe, its end."""

    def end(number: int, frame: object) -> None:
        server.ended = True

    signal.signal(signal.SIGTERM, end)
    signal.signal(signal.SIGINT, end)
    try:
        mode = os.fstat(0).st_mode
    except OSError:  # started without standard input
        return
    if stat.S_ISFIFO(mode) or stat.S_ISSOCK(mode):
        server.input = 0
