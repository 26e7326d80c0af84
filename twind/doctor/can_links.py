"""Subject: CAN interfaces of the kernel, by /sys/class/net and `ip -details -json link`. Reads only."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twind.doctor.check import (
    SUPPORT,
    Check,
    CheckNotApplicable,
    DoctorFinding,
    Fix,
    Severity,
)
from twind.doctor.check_context import CheckContext, Inspection
from twind.doctor.host_inspector import HostInspector
from twind.doctor.ports import can_interfaces
from twind.exceptions import OperationFailed
from twind_drivers.ports.can_interface_control import CAN_TYPE, LONG

SHORT = 48  # frames: two cycles of 24 actuators
RESTART_MS = 100
WELL = ("ERROR-ACTIVE", "STOPPED", "SLEEPING")  # of a controller that counts no errors; the two last: down
WARNING = "ERROR-WARNING"  # 96 errors or more counted; it still sends and receives all (ISO 11898-1)
UP = 0x1  # IFF_UP (linux/if.h)
BIT_RATE = "check the actuators' rate: a wrong one destroys the frames of all devices"

ROWS = (
    Check(
        "CAN_LINK_DOWN",
        "the CAN interface does not exist or is down",
        "the bus carries no frames",
        "plug the adapter in, `sudo modprobe can_raw`, "
        "`sudo ip link set can0 up type can bitrate RATE restart-ms 100`",
        Severity.FAULT,
        caution=BIT_RATE,
    ),
    Check(
        "CAN_LINK_STATE",
        "the CAN controller left the bus, or its interface is set wrongly",
        "wrong rate or wiring: no frame is acknowledged; without `restart-ms` the bus stays off; old frames "
        "of a long queue leave when power returns: the robot jerks",
        "check power, bit rate, termination (60 Ω, all off); `twindctl disarm`, "
        "`sudo ip link set can0 down`, then as CAN_LINK_DOWN; queue: `sudo ip link set can0 txqueuelen 48`",
        Severity.FAULT,
        caution=f"{BIT_RATE}; {SUPPORT}",
        explains=("BUS_NOISE",),
    ),
)


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
        output = host.program("ip", "-details", "-json", "link", "show", "dev", name)
    except OperationFailed:
        return plain
    return with_details(plain, output)


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


def check_links(context: CheckContext) -> Iterator[DoctorFinding]:
    """CAN_LINK_DOWN, CAN_LINK_STATE, BUS_NOISE: every interface that a bus of this robot uses."""
    links = can_interfaces(context)
    if not links:
        raise CheckNotApplicable("no bus goes through a CAN interface of the kernel")
    for bus, name in links:
        link = read_link(context.host, name)
        bitrate = context.bus(bus).baud
        if link is None or link.kind != CAN_TYPE:
            what = "no such interface" if link is None else "is no CAN interface"
            text = f"{what}; there are: {_there(context.host)}"
            yield DoctorFinding("CAN_LINK_DOWN", name, text, command=_up(name, bitrate))
        else:
            yield from judge_link(context.host, link, bitrate)


def judge_link(host: HostInspector, link: CanNetworkInterface, bitrate: int) -> Iterator[DoctorFinding]:
    """Yield the findings on one existing interface: rate, link, controller, queue, restart time."""
    name = link.name
    again = f"sudo ip link set {link.name} down\n{_up(link.name, bitrate)}"
    if link.up:  # without a disarm the actuators of an armed robot would run into their watchdogs
        again = f"twindctl disarm\n{again}"
    errors = f", errors {link.errors}" if link.errors else ""
    if link.bitrate is not None and link.bitrate != bitrate:
        yield DoctorFinding("CAN_LINK_STATE", name, f"{link.bitrate} bit/s", f"{bitrate} bit/s", again)
    if not link.up:
        yield DoctorFinding("CAN_LINK_DOWN", name, "down", "up", _up(name, bitrate))
    elif link.state == WARNING:
        yield DoctorFinding("BUS_NOISE", name, f"{link.state}{errors}", "ERROR-ACTIVE")
    elif link.state is not None and link.state not in WELL:
        yield DoctorFinding("CAN_LINK_STATE", name, f"{link.state}{errors}", "ERROR-ACTIVE", again)
    if link.queue > LONG:
        file = host.sys / "class/net" / name / "tx_queue_len"
        yield DoctorFinding(
            "CAN_LINK_STATE",
            name,
            f"a queue of {link.queue} frames",
            f"at most {LONG} frames",
            f"sudo ip link set {name} txqueuelen {SHORT}",
            Fix(f"shorten it to {SHORT}", lambda: _write(file, SHORT)),
            severity=Severity.WARNING,
        )
    if link.restart_ms == 0:
        yield DoctorFinding(
            "CAN_LINK_STATE",
            name,
            "restart-ms 0",
            f"restart-ms {RESTART_MS}",
            again,
            severity=Severity.WARNING,
        )


def _there(host: HostInspector) -> str:
    folders = sorted((host.sys / "class/net").glob("*"))
    return ", ".join(each.name for each in folders if host.number(each / "type") == CAN_TYPE) or "none"


def _up(name: str, bitrate: int) -> str:
    return f"sudo ip link set {name} up type can bitrate {bitrate} restart-ms {RESTART_MS}"


def _write(file: Path, value: int) -> None:
    file.write_text(f"{value}\n")


CHECKS = (Inspection("CAN interfaces", ("CAN_LINK_DOWN", "CAN_LINK_STATE", "BUS_NOISE"), check_links),)
