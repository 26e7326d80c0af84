"""Subject: ports of buses. Does the port exist, may the daemon open it, does another program have it?"""

import os
import stat
from collections.abc import Collection, Iterable, Iterator
from contextlib import nullcontext, suppress
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from twind.config.driver_family import family
from twind.config.port_names import Medium
from twind.ctl.instance_paths import stop
from twind.doctor import service
from twind.doctor.check import (
    OTHER_MASTER,
    UNPLUGGED,
    Check,
    CheckNotApplicable,
    DoctorFinding,
    Severity,
)
from twind.doctor.check_context import CheckContext, Inspection
from twind.doctor.host_inspector import HostInspector, PortHolder, is_daemon
from twind.exceptions import OperationFailed
from twind.protocol.socket_paths import SYSTEM
from twind_drivers.ports import can_ports
from twind_drivers.ports.serial_port import PTY

BY_ID = ("twind", "serial/by-id")  # below /dev: names by twind's udev rule, then those of the system
GUESSED = ("ttyUSB", "ttyACM")  # prefixes of names that are numbered in the order of plugging in
PROBER = "ModemManager"
IGNORED = (
    "install twind's udev rules (`sudo make install`); where no modem is in use here, "
    f"`sudo systemctl mask --now {PROBER}`"
)

ROWS = (
    Check(
        "PORT_UNSET",
        "a bus has no port, or one whose name changes after a replug",
        "without a port `live` is refused; with a changed name the daemon may drive another bus",
        "`ports: {BUS: /dev/serial/by-id/…}` in the settings, or `--port BUS=PORT`",
        Severity.NOTE,
        caution="make sure that the adapter is this robot's: servos of another robot would obey",
    ),
    Check(
        "PORT_MISSING",
        "the port does not exist, or is no serial port",
        "the robot is not connected: the daemon waits, or does not start",
        "plug it in, or use its permanent name: `ls -l /dev/serial/by-id/`",
        Severity.FAULT,
        caution=UNPLUGGED,
    ),
    Check(
        "PORT_DENIED",
        "the daemon's user may not open the port",
        "the daemon cannot reach the robot",
        "`sudo usermod -aG dialout USER`, then log in again; not `chmod 666`, not sudo",
        Severity.FAULT,
    ),
    Check(
        "PORT_HELD",
        "another program has the port",
        "two masters corrupt each other's packets; the daemon does not start",
        "end that program; another twind: `twindctl --socket DIR`",
        Severity.FAULT,
        caution=OTHER_MASTER,
        explains=("UNIT_FAILED", "NO_DAEMON"),
    ),
    Check(
        "PORT_PROBED",
        "ModemManager may probe the port as a modem",
        "it writes unexpected bytes to every new serial port",
        "twind's udev rules (`sudo make install`), or `sudo systemctl mask --now ModemManager`",
        Severity.WARNING,
        caution="without ModemManager a modem network fails: use the udev rules there",
        explains=("PORT_HELD",),
    ),
)


class PortDevice(NamedTuple):
    """Serial device of one bus: the port of a serial bus, or of the adapter of an slcan bus."""

    bus: str
    path: str
    baud: int

    @property
    def tty(self) -> str:
        """Name in the kernel: ttyUSB0."""
        return os.path.basename(os.path.realpath(self.path))


def port_devices(context: CheckContext) -> list[PortDevice]:
    """List the serial devices of all buses. Raises CheckNotApplicable, OperationFailed."""
    robot = context.need_robot()
    found = []
    for name, port in context.ports.items():
        if port is None:
            continue
        if family(robot.bus(name).kind).medium is not Medium.CAN:
            found.append(PortDevice(name, port, robot.bus(name).baud))
            continue
        parts = can_ports.parse(port)
        if parts.interface == "slcan":
            found.append(PortDevice(name, parts.channel, parts.baud))
    if not found:
        raise CheckNotApplicable("no bus has a serial port")
    return found


def can_interfaces(context: CheckContext) -> list[tuple[str, str]]:
    """List bus and interface of every bus on a CAN interface of the kernel. Raises OperationFailed."""
    robot = context.need_robot()
    buses = [
        (name, can_ports.parse(port))
        for name, port in context.ports.items()
        if port is not None and family(robot.bus(name).kind).medium is Medium.CAN
    ]
    return [(name, port.channel) for name, port in buses if port.interface == "socketcan"]


def check_unset(context: CheckContext) -> Iterator[DoctorFinding]:
    """PORT_UNSET: a bus without a port."""
    context.need_robot()
    if context.sim:
        raise CheckNotApplicable("mode sim opens no port")
    for name, port in context.ports.items():
        if port is None:
            there = _candidates(context.host)
            listed = f"plugged in: {', '.join(there)}" if there else "no USB serial adapter is plugged in"
            yield DoctorFinding("PORT_UNSET", f"bus {name}", f"no port; {listed}", "a port")


def check_present(context: CheckContext) -> Iterator[DoctorFinding]:
    """PORT_MISSING: no serial port at the path. PORT_UNSET: the name of the port changes."""
    for node in port_devices(context):
        try:
            found = os.stat(node.path)
        except FileNotFoundError:
            if os.path.realpath(node.path).startswith(PTY):
                text = f"the program that served this port has ended (bus {node.bus})"
                advice = "start it again: `twind-virtual`; of `twind --virtual` the daemon"
                yield DoctorFinding("PORT_MISSING", node.path, text, advice=advice, caution="")
                continue
            there = _candidates(context.host)
            advice = (
                f"plug it in; there are: {' '.join(there)}; use one only where it is this robot's"
                if there
                else "plug the adapter in"
            )
            yield DoctorFinding("PORT_MISSING", node.path, f"no such port (bus {node.bus})", advice=advice)
            continue
        except OSError as error:
            raise OperationFailed(f"{node.path}: {error.strerror}") from error
        if not stat.S_ISCHR(found.st_mode):
            text = f"is not a character device (bus {node.bus})"
            advice = "give a serial port: `ls -l /dev/serial/by-id/`"
            yield DoctorFinding("PORT_MISSING", node.path, text, advice=advice)
        elif os.path.basename(node.path).startswith(GUESSED) and (name := _stable(context.host, node.tty)):
            advice = f"in the settings, `ports: {{{node.bus}: {name}}}`"
            text = "a number given at plugging in"
            yield DoctorFinding("PORT_UNSET", node.path, text, name, advice=advice)


def check_permitted(context: CheckContext) -> Iterator[DoctorFinding]:
    """PORT_DENIED: the daemon's user may not read and write the device."""
    account, whose = service.runner_account(context)
    for node in port_devices(context):
        try:
            found = os.stat(node.path)
            if not stat.S_ISCHR(found.st_mode) or _may(account, Path(node.path)):
                continue
        except OSError:
            continue  # PORT_MISSING reports it
        group = service.group_name(found.st_gid)
        owner = f"{service.user_name(found.st_uid)}:{group} {stat.S_IMODE(found.st_mode):04o}"
        text = f"{whose} {account.name} may not; it is {owner}"
        expected = ""
        command = ""
        if not (found.st_mode >> 3 & 6 == 6 and found.st_gid != 0):
            expected = "group dialout, mode 0660"
            advice = "twind's udev rules give it to a group: `sudo make install`, then plug it in again"
        elif service.is_enrolled(account.uid, found.st_gid):
            user = account.name
            advice = f"{user} is in group {group}, but its processes began before: log out and in, or restart"
        else:
            command = f"sudo usermod -aG {group} {account.name}"
            advice = "this, then log in again:"
        yield DoctorFinding("PORT_DENIED", node.path, text, expected, command, advice=advice)


def check_held(context: CheckContext) -> Iterator[DoctorFinding]:
    """PORT_HELD: a program beside the daemon has a port, or owns a CAN interface of the kernel."""
    host = context.host
    ours = service.own_pids(context)
    links = can_interfaces(context)
    with suppress(CheckNotApplicable) if links else nullcontext():
        for node in port_devices(context):
            yield from _held(host, node.bus, node.path, host.holders(node.path), ours)
    for bus, interface in links:
        yield from _held(host, bus, interface, host.owners(interface), ours)


def check_probed(context: CheckContext) -> Iterator[DoctorFinding]:
    """PORT_PROBED: ModemManager runs, and no udev rule keeps it from this port. Raises OperationFailed.

    brltty is left out: it takes adapters of some makers by its own list, and its user may need it to read.
    Where it has the port, that is PORT_HELD.
    """
    host = context.host
    running = {host.text(host.proc / str(pid) / "comm"): pid for pid in host.processes()}
    for node in port_devices(context):
        if node.tty.startswith(GUESSED) and PROBER in running and not _is_ignored(host, node.tty):
            text = f"{PROBER} runs (pid {running[PROBER]}), and no udev rule keeps it from this port"
            yield DoctorFinding("PORT_PROBED", node.path, text, advice=IGNORED)


def _candidates(host: HostInspector) -> list[str]:
    """List the ports of this machine by their permanent names; without such names by their numbers."""
    for folder in BY_ID:
        names = sorted(str(each) for each in (host.dev / folder).glob("*"))
        if names:
            return names
    return sorted(str(each) for prefix in GUESSED for each in host.dev.glob(f"{prefix}*"))


def _stable(host: HostInspector, tty: str) -> str:
    """Return a name of this device that a replug does not change; "": there is none."""
    for folder in BY_ID:
        for link in sorted((host.dev / folder).glob("*")):
            if os.path.basename(os.path.realpath(link)) == tty:
                return str(link)
    return ""


def _may(account: service.UserAccount, path: Path) -> bool:
    if account == service.own_account():
        return os.access(path, os.R_OK | os.W_OK, effective_ids=True)
    return account.may(path, os.R_OK | os.W_OK)


def _held(
    host: HostInspector, bus: str, path: str, holders: Iterable[PortHolder], ours: Collection[int]
) -> Iterator[DoctorFinding]:
    for holder in holders:
        if holder.pid in ours:
            continue
        text = f"held by pid {holder.pid} ({holder.command}), bus {bus}"
        if is_daemon(" ".join(host.command_line(holder.pid))):
            advice = _other_daemon(host, holder.pid)
        elif PROBER in holder.command:
            advice = IGNORED
        else:  # it may hold a robot up: no command that kills it
            advice = f"end that program by its own command or Ctrl-C; `ps -fp {holder.pid}` shows what it is"
        yield DoctorFinding("PORT_HELD", path, text, "no other program", advice=advice)


def _other_daemon(host: HostInspector, pid: int) -> str:
    """Describe how to ask another daemon, and how to end it, by its command line or its service."""
    words = host.command_line(pid)
    unit = host.unit(pid)
    places = [
        word.partition("=")[2] or follows
        for word, follows in pairwise([*words, ""])
        if word == "--socket" or word.startswith("--socket=")
    ]
    name = unit.removeprefix("twind@").removesuffix(".service")
    place = places[-1] if places else f"{SYSTEM}/{name}" if unit.startswith("twind@") else ""
    socket = f"--socket {place} " if place else ""
    end = "Ctrl-C where it runs"
    if unit == "twind.service" or unit.startswith("twind@"):
        end = f"`{stop(place or SYSTEM)}`"
    return f"another twind has it: ask that one, `twindctl {socket}doctor`; to end it lowers its robot: {end}"


def _is_ignored(host: HostInspector, tty: str) -> bool:
    """Return whether udev keeps ModemManager from the port. Raises OperationFailed: unknown."""
    output = host.program("udevadm", "info", "--query=property", f"--name=/dev/{tty}")
    return not {"ID_MM_DEVICE_IGNORE=1", "ID_MM_PORT_IGNORE=1"}.isdisjoint(output.splitlines())


CHECKS = (
    Inspection("ports", ("PORT_UNSET",), check_unset),
    Inspection("ports", ("PORT_MISSING", "PORT_UNSET"), check_present),
    Inspection("rights", ("PORT_DENIED",), check_permitted),
    Inspection("holders", ("PORT_HELD",), check_held),
    Inspection("probing programs", ("PORT_PROBED",), check_probed),
)
