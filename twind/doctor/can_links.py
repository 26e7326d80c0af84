"""Checks of the kernel's CAN interfaces, by /sys/class/net and `ip -details -json link`. Changes none."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twind.config.actuator_types import CAN
from twind.doctor.check import CheckNotApplicable, CheckUnavailable, DoctorFinding, Fix
from twind.doctor.check_context import CheckContext
from twind.doctor.host_inspector import HostInspector
from twind_drivers.can import can_ports
from twind_drivers.can.can_interface import CAN_TYPE, LONG

SHORT = 48  # frames: two cycles of 24 actuators
RESTART_MS = 100
WELL = ("ERROR-ACTIVE", "STOPPED", "SLEEPING")  # of a controller that counts no errors; the two last: down
WARNING = "ERROR-WARNING"  # 96 errors or more counted; it still sends and hears all (ISO 11898-1)
UP = 0x1  # IFF_UP (linux/if.h)


@dataclass(frozen=True, slots=True)
class CanNetworkInterface:
    """One network interface. None: unknown (a virtual CAN has no bit rate and no controller)."""

    name: str
    kind: int  # ARPHRD_…; 280 is CAN
    up: bool
    queue: int  # frames
    bitrate: int | None = None  # bit/s
    state: str | None = None  # ERROR-ACTIVE, ERROR-WARNING, ERROR-PASSIVE, BUS-OFF, …
    restart_ms: int | None = None
    errors: str = ""  # "tx 128, rx 0"


def read_link(host: HostInspector, name: str) -> CanNetworkInterface | None:
    """Read an interface from the kernel; None: there is none of that name."""
    folder = host.sys / "class/net" / name
    kind = host.number(folder / "type")
    queue = host.number(folder / "tx_queue_len")
    flags = host.text(folder / "flags")
    if kind is None or queue is None or flags is None:
        return None
    plain = CanNetworkInterface(name, kind, bool(int(flags, 16) & UP), queue)
    try:
        said = host.program("ip", "-details", "-json", "link", "show", "dev", name)
    except CheckUnavailable:
        return plain
    return with_details(plain, said)


def with_details(link: CanNetworkInterface, text: str) -> CanNetworkInterface:
    """Add the controller data of `ip -details -json link show` to `link` (iproute2's iplink_can.c)."""
    try:
        (entry,) = json.loads(text)
        about: dict[str, Any] = entry.get("linkinfo", {}).get("info_data", {})
    except (ValueError, AttributeError):
        return link
    counted = about.get("berr_counter") or {}
    return CanNetworkInterface(
        link.name,
        link.kind,
        link.up,
        link.queue,
        bitrate=(about.get("bittiming") or {}).get("bitrate"),
        state=about.get("state"),
        restart_ms=about.get("restart_ms", 0) if "state" in about else None,
        errors=f"tx {counted.get('tx')}, rx {counted.get('rx')}" if counted else "",
    )


def links(x: CheckContext) -> Iterator[DoctorFinding]:
    """CAN_LINK_…: check every interface that a bus of this robot uses."""
    for bus, name in _configured_interfaces(x):
        link = read_link(x.host, name)
        if link is None or link.kind != CAN_TYPE:
            what = "no such interface" if link is None else "is no CAN interface"
            yield DoctorFinding(
                "CAN_LINK_MISSING",
                name,
                f"{what}; there are: {_there(x.host)}",
                command=_up(name, x.bus(bus).baud),
            )
        else:
            yield from judge(x.host, link, x.bus(bus).baud)


def judge(host: HostInspector, link: CanNetworkInterface, bitrate: int) -> Iterator[DoctorFinding]:
    """Yield the findings on one existing interface.

    Checks bit rate, link and controller state, queue length and restart time.
    """
    name = link.name
    again = f"sudo ip link set {link.name} down\n{_up(link.name, bitrate)}"
    if link.up:  # down, it takes the goals from who is armed: the actuators run into their watchdogs
        again = f"twindctl disarm\n{again}"
    if link.bitrate is not None and link.bitrate != bitrate:
        yield DoctorFinding("CAN_LINK_BITRATE", name, f"{link.bitrate} bit/s", f"{bitrate} bit/s", again)
    if not link.up:
        yield DoctorFinding("CAN_LINK_DOWN", name, "down", "up", _up(name, bitrate))
    elif link.state == WARNING:
        counted = link.errors or "errors counted"
        yield DoctorFinding("CAN_LINK_ERRORS", name, f"{link.state}, {counted}", "ERROR-ACTIVE")
    elif link.state is not None and link.state not in WELL:
        counted = f", errors {link.errors}" if link.errors else ""
        yield DoctorFinding("CAN_LINK_STATE", name, f"{link.state}{counted}", "ERROR-ACTIVE", again)
    if link.queue > LONG:
        file = host.sys / "class/net" / name / "tx_queue_len"
        fix = Fix(f"shorten it to {SHORT}", lambda: _write(file, SHORT))
        command = f"sudo ip link set {name} txqueuelen {SHORT}"
        yield DoctorFinding("CAN_LINK_QUEUE", name, f"{link.queue} frames", f"at most {LONG}", command, fix)
    if link.restart_ms == 0:
        yield DoctorFinding("CAN_LINK_RESTART", name, "restart-ms 0", f"restart-ms {RESTART_MS}", again)


def _configured_interfaces(x: CheckContext) -> list[tuple[str, str]]:
    """Return bus and interface of every socketcan port. Raises CheckNotApplicable."""
    robot = x.need_robot()
    found = []
    for bus, port in x.ports.items():
        if port is not None and robot.bus(bus).kind == CAN:
            parts = can_ports.parse(port)
            if parts.interface == "socketcan":
                found.append((bus, parts.channel))
    if not found:
        raise CheckNotApplicable("no bus goes through a CAN interface of the kernel")
    return found


def _there(host: HostInspector) -> str:
    folders = sorted((host.sys / "class/net").glob("*"))
    return ", ".join(each.name for each in folders if host.number(each / "type") == CAN_TYPE) or "none"


def _up(name: str, bitrate: int) -> str:
    return f"sudo ip link set {name} up type can bitrate {bitrate} restart-ms {RESTART_MS}"


def _write(file: Path, value: int) -> None:
    file.write_text(f"{value}\n")
