"""`twind-virtual`: a robot file's servos on pseudo-terminals, speaking the real protocol, moved by MuJoCo.

Prints `bus NAME PATH` per bus, then `ready`. Ends at end-of-file on standard input when that is a pipe, on
SIGTERM and on SIGINT.
"""

import argparse
import gc
import os
import signal
import stat
import sys
from collections.abc import Sequence
from pathlib import Path

from twind.config.located import ConfigError
from twind.config.robot_file import load_robot
from twind.loop import realtime
from twind.virtual.orders import OrderSocket
from twind.virtual.pty_port import PtyPort
from twind.virtual.serve import Server, ServoClock
from twind.virtual.specimen import Specimen, SpecimenError, buses, save, specimen
from twind_drivers.clock import MonotonicClock

PRIORITY = 30  # SCHED_FIFO: below the daemon's loop, whose servos these are


def parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = argparse.ArgumentParser(prog="twind-virtual", description="A virtual robot on pseudo-terminals.")
    parser.add_argument("--robot", default="h24", metavar="NAME|FILE", help="robot file (default h24)")
    parser.add_argument("--link", type=Path, metavar="DIR", help="keep symbolic links DIR/BUS to the ports")
    parser.add_argument("--baud", type=int, metavar="N", help="of every servo, instead of the robot file's")
    parser.add_argument("--return-delay", type=int, metavar="US", help="of every servo, us")
    parser.add_argument("--no-wire-timing", action="store_true", help="answer at once")
    parser.add_argument("--muscles", choices=("mujoco", "first-order"), default="mujoco")
    parser.add_argument("--calibration", type=Path, metavar="FILE", help="write the calibration that fits")
    parser.add_argument("--faults", type=Path, metavar="SOCKET", help="take orders for faults here")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run it. Exit code 0 at its end, 2 when it cannot be started as asked."""
    options = parser().parse_args(arguments)
    try:
        robot = load_robot(str(options.robot))
        made = specimen(robot, baud=options.baud, return_delay_us=options.return_delay)
        if options.link is not None:
            options.link.mkdir(parents=True, exist_ok=True)
        if options.calibration is not None:
            save(made, options.calibration)
        _serve(made, options)
    except (ConfigError, SpecimenError, OSError) as error:
        print(f"twind-virtual: {error}", file=sys.stderr)
        return 2
    return 0


def _say(name: str, path: str) -> None:
    print(f"bus {name} {path}", flush=True)


def _serve(made: Specimen, options: argparse.Namespace) -> None:
    clock = ServoClock(MonotonicClock())
    links = {bus.name: options.link and options.link / bus.name for bus in made.robot.buses}
    physics, timing = options.muscles == "mujoco", not options.no_wire_timing
    virtual = buses(made, physics=physics, wire_timing=timing, now=clock.now())
    ports = {name: PtyPort(name, link) for name, link in links.items()}
    server = Server(virtual, ports, clock, _say)
    try:
        if options.faults is not None:
            server.orders = OrderSocket(options.faults, server.obey)
        _until_told(server)
        for name, port in ports.items():
            _say(name, port.path)
        print("ready", flush=True)
        realtime.one_thread()
        realtime.fifo(PRIORITY)  # servos answer in time however busy the machine is, if we are let
        gc.freeze()  # what is there stays: the collector need not walk through it between two packets
        server.run()
    finally:
        if server.orders is not None:
            server.orders.close()
        for port in ports.values():
            port.unplug()


def _until_told(server: Server) -> None:
    """SIGTERM, SIGINT and, where standard input is a pipe, its end."""

    def end(number: int, frame: object) -> None:
        server.ended = True

    signal.signal(signal.SIGTERM, end)
    signal.signal(signal.SIGINT, end)
    try:
        mode = os.fstat(0).st_mode
    except OSError:  # started without standard input
        return
    if stat.S_ISFIFO(mode) or stat.S_ISSOCK(mode):
        server.end_with(0)
