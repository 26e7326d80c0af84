"""`twindctl adopt`: read files, open ports, ask, write, report. Blocks."""

import argparse
import os
import sys
from contextlib import ExitStack
from typing import Any

from twind.client import Client, ClientError, NoDaemon
from twind.command_line.verb import DONE, Rejected, UsageError, show
from twind.config.doc_pages import CALIBRATION, page
from twind.ctl.hint_options import command_hint
from twind.ctl.instance_paths import stop
from twind_calibration.rejection_hints import with_hints
from twind_calibration.robot_description import RobotDescription, read
from twind_drivers.bus import PortError, PortErrorCause
from twind_drivers.servo_tools.adoption.adoption_steps import AdoptionPlan, prepare
from twind_drivers.servo_tools.adoption.calibration_entry_status import entry_of
from twind_drivers.servo_tools.adoption.candidate_locations import (
    AdoptionCandidate,
    choose,
    joint_of,
    look,
    search_plan,
    serial_buses,
)
from twind_drivers.servo_tools.family_tools import need_tools
from twind_drivers.servo_tools.servo_configurator import ProberAtRate, open_writable

STOP = "stop the daemon (`{0}`, or Ctrl-C where it runs)"
PATIENCE = 5.0  # s for an answer of a daemon
CALIBRATE = (
    "{0} is not calibrated: live refuses to arm (CALIB_MISSING) until it is. With the daemon running: "
    "`twindctl calibrate sweep {0}`, then `twindctl calibrate zero {0}` ({1}); mirror shows it already, "
    "marked uncalibrated"
)


@with_hints
def adopt(options: argparse.Namespace) -> int:
    """Exit code 0: done, or nothing to do. Raises Rejected, UsageError."""
    return _open_and_adopt(options)


def _open_and_adopt(options: argparse.Namespace) -> int:
    _require_terminal(options)
    described = read(options)
    buses = serial_buses(described.robot)
    if options.joint is not None:
        joint = joint_of(described.robot, options.joint)
        buses = tuple(bus for bus in buses if bus.name == joint.bus)
    named = {bus: described.port(bus.name) for bus in buses}
    for port in named.values():
        _require_no_daemon(options, described, port)
    try:
        with ExitStack() as stack:
            opened = {
                bus.name: open_writable(port, need_tools(bus.kind).protocol, stack)
                for bus, port in named.items()
            }
            return _adopt(options, described, opened)
    except PortError as error:  # held (by whom), not there, lost
        stopped = STOP.format(stop(str(described.sockets)))
        hint = f". A daemon there? {stopped}, then try again" if error.kind is PortErrorCause.IN_USE else ""
        raise Rejected(f"{error}{hint}") from error


def _adopt(options: argparse.Namespace, described: RobotDescription, opened: dict[str, ProberAtRate]) -> int:
    robot = described.robot
    heard = {}
    for bus, at in opened.items():
        rates = " and ".join(map(str, search_plan(robot, robot.bus(bus))))
        _print_line(options, f"looking for servos on bus {bus} at {rates} baud ...")
        heard[bus] = look(at, robot, robot.bus(bus))
    chosen = choose(robot, heard, options.joint)
    if chosen is None:
        count = sum(joint.bus in opened for joint in robot.joints)
        show(options, {"state": "complete"}, f"nothing to adopt: all {count} joints have their servo")
        return DONE
    name = chosen.joint.name
    entry = entry_of(robot, described.calibration, chosen.joint.actuator, described.usual)
    _refuse_calibrated_place(described, chosen)
    adoption = prepare(chosen, opened[chosen.bus.name], entry)
    if adoption.nothing:
        text = f"{name} has its servo, {chosen.home}, and that holds what it must; {adoption.entry}"
        show(options, adoption.to_json("there"), text)
        return DONE
    if options.dry_run:
        show(options, adoption.to_json("planned"), "\n".join([*adoption.lines(), "nothing was written"]))
        return DONE
    _ask(options, adoption)
    try:
        adoption.carry_out()
    except KeyboardInterrupt:
        _print_line(options, f"cut short: `twindctl adopt {name}` once more finds the servo and ends it")
        raise
    adopted = f"{name} has its servo: {chosen.home} on bus {chosen.bus.name}, torque off"
    text = command_hint(options).prose(f"{adopted}\n{CALIBRATE.format(name, page(CALIBRATION))}")
    show(options, adoption.to_json("adopted"), text)
    return DONE


def _require_terminal(options: argparse.Namespace) -> None:
    """Raises UsageError without a terminal for the question, before the search."""
    if options.yes or options.dry_run:
        return
    if options.json:
        raise UsageError("--json asks no question: add --yes, or --dry-run to see what would be written")
    if not sys.stdin.isatty():
        raise UsageError("cannot ask: standard input is no terminal; add --yes, or --dry-run")


def _ask(options: argparse.Namespace, adoption: AdoptionPlan) -> None:
    """Print the planned writes and ask. Raises Rejected without consent."""
    for line in adoption.lines():
        _print_line(options, line)
    if options.yes:
        return
    print("write this? [y/N] ", end="", file=sys.stderr, flush=True)
    if sys.stdin.readline().strip().lower() not in ("y", "yes"):
        raise Rejected("nothing was written")


def _print_line(options: argparse.Namespace, line: str) -> None:
    if not options.json:
        print(command_hint(options).prose(line), file=sys.stderr, flush=True)


def _refuse_calibrated_place(described: RobotDescription, chosen: AdoptionCandidate) -> None:
    """Raises Rejected for a servo at the place of another, calibrated joint: it may be that joint's own."""
    robot = described.robot
    for other in robot.joints:
        here = (other.bus, other.id, robot.bus(other.bus).baud)
        if other is chosen.joint or here != (chosen.bus.name, chosen.place.id, chosen.place.baud):
            continue
        entry = entry_of(robot, described.calibration, other.actuator, described.usual)
        if entry.there:
            raise Rejected(
                f"the only servo is at the place of {other.name}, which is calibrated; with a cut cable it "
                f"is that one. Mend the cable; if it is a new servo, take the entry of {other.name} out of "
                f"{entry.path} first"
            )


def _require_no_daemon(options: argparse.Namespace, described: RobotDescription, port: str) -> None:
    """Raises Rejected: a daemon has this port, takes it again as soon as it is free, or does not say.

    It owns its bus at its own rate, and would go on with the calibration of the servo that is gone.
    """
    for place in dict.fromkeys((options.socket, None, str(described.sockets))):
        status = status_at(place)
        if status is None:
            continue
        its = {os.path.realpath(bus["port"]) for bus in status["buses"] if bus["port"]}
        if status["mode"] != "sim" and os.path.realpath(port) in its:
            path = status["path"]
            stopped = STOP.format(stop(path))
            raise Rejected(f"{port}: the daemon at {path} has this port: {stopped}, then try again")


def status_at(place: str | None) -> dict[str, Any] | None:
    """Return the status of the daemon at `place`, with the `path` of its socket; None: no daemon runs there.

    Raises Rejected: a daemon may run there, but denies access or does not answer.
    """
    denied: NoDaemon | None = None
    for name in ("observe", "control"):
        with Client(place, name=name, timeout=PATIENCE) as client:
            try:
                return {**client.call("GetStatus")["status"], "path": client.path}
            except NoDaemon as error:
                denied = denied if error.absent else error
            except ClientError as error:
                stopped = STOP.format(stop(client.path))
                raise Rejected(
                    f"{client.path}: a daemon listens there and does not say which ports it has ({error}): "
                    f"{stopped}, then try again"
                ) from error
    if denied is not None:
        raise Rejected(f"{denied}. A daemon may hold this port: try with sudo") from denied
    return None
