"""`twindctl scan --port` of one family: opens the port exclusively, tries every rate and id. Blocks."""

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial

from twind.command_line.progress import ProgressLine
from twind.command_line.verb import DONE, REFUSED, Rejected
from twind_drivers.bus import PortError
from twind_drivers.clock import Clock, MonotonicClock
from twind_drivers.ports.serial_port import SerialTransport
from twind_drivers.servo_tools.bus_scan import BaudRateScan, ScannedDevice, estimate, ids_of, scan
from twind_drivers.servo_tools.prober import PortProber
from twind_drivers.servo_tools.scan_protocol import ScanProtocol

FIRST_BAUD = 57_600  # every adapter has it; nothing is sent at it


def scan_port(protocol: ScanProtocol, options: argparse.Namespace) -> int:
    """Return exit code 0: a device was found, and no device has a fault. Raises Rejected with a reason."""
    try:
        port = SerialTransport(options.port, FIRST_BAUD)
        try:
            return _scan(protocol, options, port, MonotonicClock())
        finally:
            port.close()
    except PortError as error:  # held (by whom), not there, lost
        raise Rejected(str(error)) from error


def _scan(protocol: ScanProtocol, options: argparse.Namespace, port: SerialTransport, clock: Clock) -> int:
    """Scan rate after rate and print each result at once.

    Raises PortError, Rejected where no device answers.
    """
    bauds = tuple(options.baud or protocol.bauds)
    every = ids_of(protocol)
    ids = [id for id in options.ids or every if id in every]
    if not ids:
        raise Rejected(f"{protocol.kind} devices have ids up to {protocol.last_id}")
    timer = (port.latency_ms or 0) * 1e-3

    def open_prober(baud: int) -> PortProber:
        port.set_baud(baud)
        return PortProber(port, clock, baud, protocol, timer=timer)

    seconds = sum(estimate(protocol, baud, ids, thorough=options.thorough, timer=timer) for baud in bauds)
    _begin(protocol.kind, options, port, bauds, ids, seconds)
    rates = []
    with ProgressLine(options, "scan", seconds=seconds, now=clock.now) as progress:
        tell = partial(_report_progress, progress)
        for rate in scan(open_prober, bauds, ids, thorough=options.thorough, tell=tell):
            progress.clear()
            rates.append(rate)
            _show(protocol, options, rate)
    found = [each for rate in rates for each in rate.found]
    if not found:
        more = " Without --baud all rates are searched." if options.baud else ""
        what = f"{protocol.kind} device" if options.kind else "device"
        question = "is the power on, and the data line connected?"
        raise Rejected(f"{port.name}: no {what} answers: {question}{more}")
    return REFUSED if any(each.trouble for each in found) else DONE


def _report_progress(progress: ProgressLine, baud: int, what: str) -> None:
    progress.update(f"{baud} baud: {what}")


def _begin(
    kind: str,
    options: argparse.Namespace,
    port: SerialTransport,
    bauds: Sequence[int],
    ids: Sequence[int],
    seconds: float,
) -> None:
    """Print the planned scan, its estimated duration, and the port's warning, if any; nothing with --json."""
    if options.json:
        return
    rates = "1 baud rate" if len(bauds) == 1 else f"{len(bauds)} baud rates"
    says = f"{port.name}: {kind}, ids {min(ids)} to {max(ids)} at {rates}, about {seconds:.0f} s"
    print(says, file=sys.stderr, flush=True)
    if port.warning:
        print(f"{port.name}: {port.warning}", file=sys.stderr, flush=True)


def _show(protocol: ScanProtocol, options: argparse.Namespace, rate: BaudRateScan) -> None:
    """Print one rate: a line of JSON or text per device, then the troubles of the line."""
    for each in rate.found:
        data = {"kind": protocol.kind} | asdict(each) | _trouble(each)
        print(json.dumps(data) if options.json else _text(protocol, each), flush=True)
    for trouble in rate.troubles:
        text = {"baud": rate.baud, "trouble": str(trouble)}
        print(json.dumps(text) if options.json else f"{rate.baud:>7} baud  {trouble}", flush=True)


def _trouble(each: ScannedDevice) -> dict[str, str]:
    """Format a trouble as text, in JSON too; "" where there is none."""
    return {"trouble": str(each.trouble) if each.trouble else ""}


def _text(protocol: ScanProtocol, each: ScannedDevice) -> str:
    unknown = "unknown" if each.model is None else f"{protocol.kind} model {each.model}"
    words = [f"{each.baud:>7} baud", f"id {each.id:>3}", each.model_name or unknown]
    if each.firmware is not None:
        words.append(f"firmware {each.firmware}")
    if each.torque is not None:
        words.append(f"torque {'on' if each.torque else 'off'}")
    if each.hardware_error:
        words.append(f"hardware error: {protocol.explain(each.hardware_error)}")
    return "  ".join([*words, *([str(each.trouble)] if each.trouble else [])])
