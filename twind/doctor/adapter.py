"""Subject: the USB adapter of a serial port. Latency timer, suspension, hubs, baud rate, measured latency."""

import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from twind.config.driver_family import family
from twind.config.port_names import Medium
from twind.config.robot_spec import BusSpec
from twind.doctor.check import (
    UNPLUGGED,
    Check,
    CheckNotApplicable,
    DoctorFinding,
    Fix,
    Severity,
)
from twind.doctor.check_context import CheckContext, Inspection
from twind.doctor.family_doctor import doctor_of
from twind.doctor.host_inspector import HostInspector
from twind.doctor.ports import port_devices
from twind.exceptions import OperationFailed
from twind_drivers.bus import PortError

HUBS = 2  # hubs in a row that do no harm
# Highest rates by kernel driver, bit/s (data sheets: CP2102N 3 M, CH340 2 M, PL2303 6 M; FTDI's vary).
FASTEST = {"cp210x": 3_000_000, "ch341-uart": 2_000_000, "ch341": 2_000_000, "pl2303": 6_000_000}
ENOUGH = 6  # replies
PUNCTUAL = 0.9  # of the last 100 ticks
LOST = 0.2  # of all exchanges
LATE_ADVICE = (
    "set the latency timer to 1 ms (LATENCY_TIMER), and Return Delay Time of each servo to 5: "
    "`twindctl register write BUS ID return_delay_time 5`, torque off"
)
LATER = "stop it and ask again, then the port itself is measured"
FLOOR = 0.004  # s beside the wire: a timer of 1 ms, USB frames and a busy machine stay below
MARGIN = 0.003  # s of it that are for the frames and the machine

ROWS = (
    Check(
        "LATENCY_TIMER",
        "the adapter has a long latency timer, or may be suspended",
        "16 ms allow at most 50 to 60 readings per second; after a suspension the first packet is lost",
        "`echo 1 | sudo tee /sys/bus/usb-serial/devices/ttyUSB0/latency_timer`, or `echo on` to its "
        "`power/control`; permanently: `sudo make install`",
        Severity.WARNING,
        explains=("LATENCY_FLOOR",),
    ),
    Check(
        "LATENCY_FLOOR",
        "replies are late, as with a long latency timer or return delay, or the adapter is behind hubs",
        "readings are old and few, or devices count as missing; above 100 ms motion is refused",
        "LATENCY_TIMER by sysfs, not `setserial`; RETURN_DELAY; no hub, no virtual machine; another adapter",
        Severity.WARNING,
        caution=UNPLUGGED,
    ),
    Check(
        "BAUD_UNSUPPORTED",
        "the adapter does not support this baud rate",
        "servos are silent or replies are corrupt",
        "another adapter, or a lower `baud` in robot file and servos",
        Severity.FAULT,
        caution=UNPLUGGED,
    ),
)


def check_timers(context: CheckContext) -> Iterator[DoctorFinding]:
    """LATENCY_TIMER: the value of the adapter, after a request for low latency as the daemon makes it."""
    for node in port_devices(context):
        file = context.host.sys / "class/tty" / node.tty / "device/latency_timer"
        wanted = max(1, context.bus(node.bus).latency_timer_ms)
        value = context.host.number(file)
        if value is not None and value > wanted and (line := _serial_lines(context).get(node.bus)):
            with suppress(OperationFailed):  # held, or not permitted: the timer stays as it is
                line.transport  # noqa: B018  opening requests low latency
            value = context.host.number(file)
        if value is not None and value > wanted:
            command = f"echo {wanted} | sudo tee {file}"
            fix = _write_fix(f"set the timer to {wanted} ms", file, str(wanted))
            yield DoctorFinding(
                "LATENCY_TIMER", node.path, f"latency timer {value} ms", f"{wanted} ms", command, fix
            )


def check_usb(context: CheckContext) -> Iterator[DoctorFinding]:
    """LATENCY_TIMER: the adapter may be suspended. LATENCY_FLOOR, as a note: it is behind several hubs."""
    host = context.host
    places = [
        (node, place) for node in port_devices(context) if (place := _usb_device(host, node.tty)) is not None
    ]
    if not places:
        raise CheckNotApplicable("no port hangs on USB")
    for node, place in places:
        control = place / "power/control"
        delay = host.number(place / "power/autosuspend_delay_ms")
        if host.text(control) == "auto" and (delay is None or delay >= 0):
            command = f"echo on | sudo tee {control}"
            fix = _write_fix("keep it awake", control, "on")
            yield DoctorFinding("LATENCY_TIMER", node.path, "power/control is auto", "on", command, fix)
        hubs = place.name.count(".")
        if hubs > HUBS:
            text = f"behind {hubs} hubs ({place.name})"
            advice = "plug the adapter into the computer"
            yield DoctorFinding(
                "LATENCY_FLOOR", node.path, text, f"at most {HUBS}", advice=advice, severity=Severity.NOTE
            )


def check_rates(context: CheckContext) -> Iterator[DoctorFinding]:
    """BAUD_UNSUPPORTED: by the driver of the adapter, and on a free port by the kernel.

    A missing port has no rate; PORT_MISSING reports it.
    """
    for node in port_devices(context):
        if not os.path.exists(node.path):
            continue
        driver = (context.host.sys / "class/tty" / node.tty / "device/driver").resolve().name
        most = FASTEST.get(driver)
        if most is not None and node.baud > most:
            text = f"{node.baud} baud asked for (bus {node.bus}), its driver {driver} does {most} at most"
            yield DoctorFinding("BAUD_UNSUPPORTED", node.path, text, f"{most} baud or less")
            continue
        line = _serial_lines(context).get(node.bus)
        if line is None:
            continue
        try:
            line.transport  # noqa: B018  opening sets the rate and reads back the kernel's
        except OperationFailed as error:
            if isinstance(error.__cause__, PortError):
                yield DoctorFinding("BAUD_UNSUPPORTED", node.path, error.__cause__.reason)


def check_latency(context: CheckContext) -> Iterator[DoctorFinding]:
    """LATENCY_FLOOR: by round trips of pings on a free port, or by the figures of a running daemon."""
    if context.daemon is not None:
        yield from _latency_by_daemon(context)
        return
    lines = _serial_lines(context)
    if not lines:
        raise CheckNotApplicable("no serial port")
    silent: list[str] = []
    for name, line in lines.items():
        delays = line.ping_delays([joint.id for joint in context.need_robot().joints if joint.bus == name])
        if len(delays) < ENOUGH:
            silent.append(f"{name}: no device answers on {line.port}")
            continue
        wire, longest = line.ping_time
        # The first meets the timer anywhere; on a busy machine one may be luck, and most are slow.
        quick = wire + sorted(delays[1:])[1]
        timer = context.bus(name).latency_timer_ms
        yield from judge_latency(
            line.port, quick, wire + longest, timer, f"the quicker of {len(delays)} pings"
        )
    if silent:
        raise OperationFailed("; ".join(silent))


def judge_latency(port: str, took: float, wire: float, timer_ms: float, what: str) -> Iterator[DoctorFinding]:
    """Yield LATENCY_FLOOR for a time `took` (s) beyond wire time and the timer of the robot file."""
    bound = wire + max(FLOOR, timer_ms * 1e-3 + MARGIN)
    if took > bound:
        text = f"{what} took {took * 1e3:.1f} ms, the wire needs {wire * 1e3:.1f} ms"
        yield DoctorFinding("LATENCY_FLOOR", port, text, f"at most {bound * 1e3:.1f} ms")


def _latency_by_daemon(context: CheckContext) -> Iterator[DoctorFinding]:
    """Judge two hops of the daemon: request to first byte, and first to last byte, over 100 readings.

    The timer runs freely, so a reading at a fixed rate waits for none or all of it: the mean is half a timer
    too long. A reply that waits past the reader's deadline is lost and looks like silence, and a late loop
    proves nothing: both make the check unavailable.
    """
    daemon = context.need_daemon()
    serial = _serial_buses(context)
    if not serial:
        raise CheckNotApplicable("no serial port")
    if context.sim:
        raise CheckNotApplicable("mode sim opens no port")
    late = [(bus["port"], bus["late_reply_ms"]) for bus in daemon.status["buses"] if bus.get("late_reply_ms")]
    for port, delay in late:
        text = f"replies come {delay:.0f} ms after their request, too late for the daemon to read"
        yield DoctorFinding("LATENCY_FLOOR", port, text, "within the tick", advice=LATE_ADVICE)
    if late:
        return
    hops = daemon.latency
    mean = [hops[name]["mean_ms"] for name in ("request", "reply") if name in hops]
    if len(mean) < 2 or None in mean:
        raise OperationFailed(f"the daemon receives no reply; {LATER}")
    for bus in daemon.status["buses"]:
        if bus["errors"] > LOST * bus["exchanges"]:
            lost = f"{bus['errors']} of {bus['exchanges']} readings of bus {bus['name']} were not whole"
            raise OperationFailed(f"{lost}, and a long latency timer looks like that too; {LATER}")
    if daemon.status["loop"]["on_time"] < PUNCTUAL:
        raise OperationFailed(f"the loop itself is late; {LATER}")
    yield from judge_latency(
        " ".join(str(context.ports.get(bus.name)) for bus in serial),
        sum(mean) / 1e3,
        max(_reading_time(context, bus) for bus in serial),
        max(bus.latency_timer_ms for bus in serial),
        "the mean reading",
    )


def _serial_buses(context: CheckContext) -> list[BusSpec]:
    """List the serial buses whose family has a doctor."""
    buses = context.need_robot().buses
    return [bus for bus in buses if family(bus.kind).medium is Medium.SERIAL and family(bus.kind).doctor]


def _serial_lines(context: CheckContext) -> dict[str, Any]:
    """Return the inspectors of free serial buses, by bus."""
    names = [bus.name for bus in _serial_buses(context)]
    return {name: line for name, line in context.lines.items() if name in names}


def _reading_time(context: CheckContext, bus: BusSpec) -> float:
    joints = [joint for joint in context.need_robot().joints if joint.bus == bus.name]
    return doctor_of(family(bus.kind)).reading_time(bus, joints)


def _usb_device(host: HostInspector, tty: str) -> Path | None:
    """Return the folder in /sys of the USB device of a tty; None: it is not on USB."""
    node = (host.sys / "class/tty" / tty / "device").resolve()
    return next((above for above in (node, *node.parents) if (above / "idVendor").exists()), None)


def _write_fix(text: str, file: Path, value: str) -> Fix:
    def write() -> None:
        file.write_text(f"{value}\n")

    return Fix(text, write)


CHECKS = (
    Inspection("latency timers", ("LATENCY_TIMER",), check_timers),
    Inspection("USB", ("LATENCY_TIMER", "LATENCY_FLOOR"), check_usb),
    Inspection("baud rates", ("BAUD_UNSUPPORTED",), check_rates),
    Inspection("latency", ("LATENCY_FLOOR",), check_latency),
)
