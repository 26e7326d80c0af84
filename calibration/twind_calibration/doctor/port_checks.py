"""Checks of the serial ports: there, ours to open, free, awake. Opens one only where a `Line` may."""

import os
import stat
from collections.abc import Collection, Iterable, Iterator
from contextlib import nullcontext, suppress
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from twind.config.actuator_types import CAN
from twind.protocol.socket_paths import SYSTEM
from twind_calibration.doctor import systemd, user_account
from twind_calibration.doctor.check import CheckNotApplicable, CheckUnavailable, DoctorFinding, Fix
from twind_calibration.doctor.check_context import CheckContext
from twind_calibration.doctor.host_inspector import HostInspector, PortHolder, is_daemon
from twind_calibration.doctor.user_account import UserAccount
from twind_calibration.instances import stop
from twind_drivers.bus import PortError, PortFault
from twind_drivers.can import can_ports

BY_ID = ("twind", "serial/by-id")  # below /dev: our udev rule's names, then the stock ones
GUESSED = ("ttyUSB", "ttyACM")  # numbers of these are given in the order of plugging in
PROBER = "ModemManager"
IGNORED = (
    "install twind's udev rules (`sudo make install`); where no modem is in use here, "
    f"`sudo systemctl mask --now {PROBER}`"
)
HUBS = 2  # hubs in a row that are no matter
FAST = 480  # Mbit/s, USB 2 high speed
# Highest rates by kernel driver, bit/s (data sheets: CP2102N 3 M, CH340 2 M, PL2303 6 M; FTDI's vary).
FASTEST = {"cp210x": 3_000_000, "ch341-uart": 2_000_000, "ch341": 2_000_000, "pl2303": 6_000_000}


class PortDevice(NamedTuple):
    """The serial device of one bus: of a serial bus its port, of a slcan bus what the adapter hangs on."""

    bus: str
    path: str
    baud: int

    @property
    def tty(self) -> str:
        """Its name in the kernel: ttyUSB0."""
        return os.path.basename(os.path.realpath(self.path))


def nodes(x: CheckContext) -> list[PortDevice]:
    """Serial devices of all buses that have a port. Raises NothingThere, CannotLook."""
    robot = x.need_robot()
    found = []
    for name, port in x.ports.items():
        if port is None:
            continue
        if robot.bus(name).kind != CAN:
            found.append(PortDevice(name, port, robot.bus(name).baud))
            continue
        parts = can_ports.parse(port)
        if parts.interface == "slcan":
            found.append(PortDevice(name, parts.channel, parts.baud))
    if not found:
        raise CheckNotApplicable("no bus has a serial port")
    return found


def unset(x: CheckContext) -> Iterator[DoctorFinding]:
    """PORT_UNSET: a bus without a port."""
    x.need_robot()
    if x.sim:
        raise CheckNotApplicable("mode sim opens no port")
    for name, port in x.ports.items():
        if port is None:
            there = candidates(x.host)
            listed = f"plugged in: {', '.join(there)}" if there else "no USB serial adapter is plugged in"
            yield DoctorFinding("PORT_UNSET", f"bus {name}", f"no port; {listed}", "a port")


def present(x: CheckContext) -> Iterator[DoctorFinding]:
    """PORT_MISSING, PORT_UNFIT, PORT_RENUMBERED: what stands at the path."""
    for node in nodes(x):
        try:
            found = os.stat(node.path)
        except FileNotFoundError:
            there = candidates(x.host)
            advice = (
                f"plug it in; there are: {' '.join(there)}; use one only where it is this robot's"
                if there
                else "plug the adapter in"
            )
            yield DoctorFinding("PORT_MISSING", node.path, f"no such port (bus {node.bus})", advice=advice)
            continue
        except OSError as error:
            raise CheckUnavailable(f"{node.path}: {error.strerror}") from error
        if not stat.S_ISCHR(found.st_mode):
            yield DoctorFinding("PORT_UNFIT", node.path, f"is not a character device (bus {node.bus})")
        elif os.path.basename(node.path).startswith(GUESSED) and (name := stable(x.host, node.tty)):
            advice = f"in the settings, `ports: {{{node.bus}: {name}}}`"
            yield DoctorFinding(
                "PORT_RENUMBERED", node.path, "a number given at plugging in", name, advice=advice
            )


def permitted(x: CheckContext) -> Iterator[DoctorFinding]:
    """PORT_DENIED: may the daemon's user read and write the node?"""
    who, whose = runner(x)
    for node in nodes(x):
        try:
            found = os.stat(node.path)
            if not stat.S_ISCHR(found.st_mode) or _may(who, Path(node.path)):
                continue
        except OSError:
            continue  # PORT_MISSING says it
        group = user_account.group_name(found.st_gid)
        mode = f"{stat.S_IMODE(found.st_mode):04o}"
        said = f"{whose} {who.name} may not; it is {user_account.user_name(found.st_uid)}:{group} {mode}"
        group_may = found.st_mode >> 3 & 6 == 6 and found.st_gid != 0
        if group_may and user_account.enrolled(who.uid, found.st_gid):
            advice = (
                f"{who.name} is in group {group}, but its processes began before: log out and in, or restart"
            )
            yield DoctorFinding("PORT_DENIED", node.path, said, advice=advice)
        elif group_may:
            command = f"sudo usermod -aG {group} {who.name}"
            yield DoctorFinding(
                "PORT_DENIED", node.path, said, command=command, advice="this, then log in again:"
            )
        else:
            advice = "twind's udev rules give it to a group: `sudo make install`, then plug it in again"
            yield DoctorFinding("PORT_DENIED", node.path, said, "group dialout, mode 0660", advice=advice)


def check_port_held(x: CheckContext) -> Iterator[DoctorFinding]:
    """PORT_HELD: who beside our daemon has a port, or owns a CAN interface of the kernel."""
    ours = {systemd.daemon_pid(x)} if x.daemon is not None else set()
    links = _interfaces(x)
    with suppress(CheckNotApplicable) if links else nullcontext():
        for node in nodes(x):
            yield from _held(x.host, node.bus, node.path, x.host.holders(node.path), ours)
    for bus, interface in links:
        yield from _held(x.host, bus, interface, x.host.owners(interface), ours)


def probed(x: CheckContext) -> Iterator[DoctorFinding]:
    """PORT_PROBED: ModemManager runs, and nothing keeps it from this port. Raises CannotLook: no udevadm.

    Not brltty: it takes adapters of some makers by its own list, and may be all that its user reads with.
    Where it has the port, that is PORT_HELD.
    """
    running = {x.host.text(x.host.proc / str(pid) / "comm"): pid for pid in x.host.processes()}
    for node in nodes(x):
        if node.tty.startswith(GUESSED) and PROBER in running and not _ignored(x.host, node.tty):
            said = f"{PROBER} runs (pid {running[PROBER]}) and nothing tells it to leave this port alone"
            yield DoctorFinding("PORT_PROBED", node.path, said, advice=IGNORED)


def timers(x: CheckContext) -> Iterator[DoctorFinding]:
    """LATENCY_TIMER: what the adapter says of itself, once asked for low latency as the daemon asks."""
    for node in nodes(x):
        file = x.host.sys / "class/tty" / node.tty / "device/latency_timer"
        value = x.host.number(file)
        wanted = _timer_of(x, node)
        if value is not None and value > wanted and node.bus in x.lines:
            with suppress(CheckUnavailable):  # held, or not ours to open: then it stays as it is
                x.lines[node.bus].transport  # noqa: B018  opening it asks
            value = x.host.number(file)
        if value is not None and value > wanted:
            command = f"echo {wanted} | sudo tee {file}"
            fix = Fix(f"set the timer to {wanted} ms", lambda file=file, to=wanted: _write(file, to))  # type: ignore[misc]
            yield DoctorFinding(
                "LATENCY_TIMER", node.path, f"latency timer {value} ms", f"{wanted} ms", command, fix
            )


def usb(x: CheckContext) -> Iterator[DoctorFinding]:
    """USB_AUTOSUSPEND, USB_HUBS: the adapter's place on the USB tree."""
    places = [(node, place) for node in nodes(x) if (place := usb_device(x.host, node.tty)) is not None]
    if not places:
        raise CheckNotApplicable("no port hangs on USB")
    for node, place in places:
        control = place / "power/control"
        delay = x.host.number(place / "power/autosuspend_delay_ms")
        if x.host.text(control) == "auto" and (delay is None or delay >= 0):
            command = f"echo on | sudo tee {control}"
            fix = Fix("keep it awake", lambda file=control: _write(file, "on"))  # type: ignore[misc]
            yield DoctorFinding("USB_AUTOSUSPEND", node.path, "power/control is auto", "on", command, fix)
        hubs = place.name.count(".")
        if hubs > HUBS:
            yield DoctorFinding(
                "USB_HUBS", node.path, f"behind {hubs} hubs ({place.name})", f"at most {HUBS}"
            )


def rates(x: CheckContext) -> Iterator[DoctorFinding]:
    """BAUD_UNSUPPORTED: by the adapter's driver, and where the port is free by asking the kernel."""
    for node in nodes(x):
        driver = (x.host.sys / "class/tty" / node.tty / "device/driver").resolve().name
        most = FASTEST.get(driver)
        if most is not None and node.baud > most:
            said = f"{node.baud} baud asked for (bus {node.bus}), its driver {driver} does {most} at most"
            yield DoctorFinding("BAUD_UNSUPPORTED", node.path, said, f"{most} baud or less")
            continue
        line = x.lines.get(node.bus)
        if line is None:
            continue
        try:
            line.transport  # noqa: B018  opening it sets the rate and reads back what the kernel made of it
        except CheckUnavailable as error:
            cause = error.__cause__
            if isinstance(cause, PortError) and cause.kind is PortFault.BAUD_RATE:
                yield DoctorFinding("BAUD_UNSUPPORTED", node.path, cause.reason)


# ------------------------------------------------------------------------------------------- looking


def runner(x: CheckContext) -> tuple[UserAccount, str]:
    """As whom the daemon runs or would run, and what that is called. Raises CannotLook."""
    if x.daemon is not None:
        return user_account.of_process(x.host.proc, systemd.daemon_pid(x)), "the daemon's user"
    try:
        seen = systemd.service(x)
    except CheckNotApplicable:
        return user_account.own(), "this user"
    return user_account.of_service(
        seen.get("User", ""), seen.get("SupplementaryGroups", "")
    ), "the service's user"


def candidates(host: HostInspector) -> list[str]:
    """Ports that are there, by the names that stay; without such names by their numbers."""
    for folder in BY_ID:
        names = sorted(str(each) for each in (host.dev / folder).glob("*"))
        if names:
            return names
    return sorted(str(each) for prefix in GUESSED for each in host.dev.glob(f"{prefix}*"))


def stable(host: HostInspector, tty: str) -> str:
    """A name of this device that a replug does not change; "" where there is none."""
    for folder in BY_ID:
        for link in sorted((host.dev / folder).glob("*")):
            if os.path.basename(os.path.realpath(link)) == tty:
                return str(link)
    return ""


def usb_device(host: HostInspector, tty: str) -> Path | None:
    """Folder in /sys of the USB device that a tty belongs to; None: it hangs on no USB."""
    node = (host.sys / "class/tty" / tty / "device").resolve()
    return next((above for above in (node, *node.parents) if (above / "idVendor").exists()), None)


def _may(who: UserAccount, path: Path) -> bool:
    if who == user_account.own():
        return os.access(path, os.R_OK | os.W_OK, effective_ids=True)
    return who.may(path, os.R_OK | os.W_OK)


def _interfaces(x: CheckContext) -> list[tuple[str, str]]:
    """Bus and interface of every bus on a CAN interface of the kernel."""
    robot = x.need_robot()
    buses = [
        (name, can_ports.parse(port))
        for name, port in x.ports.items()
        if port and robot.bus(name).kind == CAN
    ]
    return [(name, port.channel) for name, port in buses if port.interface == "socketcan"]


def _held(
    host: HostInspector, bus: str, path: str, holders: Iterable[PortHolder], ours: Collection[int | None]
) -> Iterator[DoctorFinding]:
    for holder in holders:
        if holder.pid in ours:
            continue
        what = f"held by pid {holder.pid} ({holder.command}), bus {bus}"
        if is_daemon(" ".join(host.command_line(holder.pid))):
            advice = _another(host, holder.pid)
        elif PROBER in holder.command:
            advice = IGNORED
        else:  # it may hold a robot up: no command that kills it
            advice = f"end that program by its own command or Ctrl-C; `ps -fp {holder.pid}` shows what it is"
        yield DoctorFinding("PORT_HELD", path, what, "no other program", advice=advice)


def _another(host: HostInspector, pid: int) -> str:
    """How to come to another twind, or to end it; by its command line, or its service."""
    words = host.command_line(pid)
    unit = host.unit(pid)
    told = [word.partition("=")[2] or follows for word, follows in pairwise([*words, ""]) if _names(word)]
    name = unit.removeprefix("twind@").removesuffix(".service")
    place = told[-1] if told else f"{SYSTEM}/{name}" if unit.startswith("twind@") else ""
    socket = f"--socket {place} " if place else ""
    end = "Ctrl-C where it runs"
    if unit == "twind.service" or unit.startswith("twind@"):
        end = f"`{stop(place or SYSTEM)}`"
    return f"another twind has it: ask that one, `twindctl {socket}doctor`; to end it lowers its robot: {end}"


def _names(word: str) -> bool:
    return word == "--socket" or word.startswith("--socket=")


def _ignored(host: HostInspector, tty: str) -> bool:
    """Does udev tell ModemManager to leave the port alone? Raises CannotLook where nobody can say."""
    said = host.program("udevadm", "info", "--query=property", f"--name=/dev/{tty}")
    return not {"ID_MM_DEVICE_IGNORE=1", "ID_MM_PORT_IGNORE=1"}.isdisjoint(said.splitlines())


def _timer_of(x: CheckContext, node: PortDevice) -> int:
    """ms: what the robot file reckons with, at least 1."""
    return max(1, x.bus(node.bus).latency_timer_ms)


def _write(file: Path, value: object) -> None:
    file.write_text(f"{value}\n")
