"""`twindctl scan --port`: opens the port exclusively and tries every rate and id. Blocks."""

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
from twind_drivers.dynamixel.bus_scan import BAUDS, IDS, BaudRateScan, ScannedDevice, estimate, scan
from twind_drivers.dynamixel.prober import PortProber
from twind_drivers.ports.serial_port import SerialTransport

# Bits of register 70 (e-manual, "Hardware Error Status").
BITS = {0: "input voltage", 2: "overheating", 3: "encoder", 4: "electrical shock", 5: "overload"}


def look(options: argparse.Namespace) -> int:
    """Return exit code 0: a device was found, and no device has a fault. Raises Rejected with a reason."""
    try:
        port = SerialTransport(options.port, BAUDS[0])  # which every adapter has; nothing is sent yet
        try:
            return _look(options, port, MonotonicClock())
        finally:
            port.close()
    except PortError as error:  # held (by whom), not there, lost
        raise Rejected(str(error)) from error


def _look(options: argparse.Namespace, port: SerialTransport, clock: Clock) -> int:
    """Scan rate after rate and print each result at once.

    Raises PortError, Rejected where no device answers.
    """
    bauds = tuple(options.baud or BAUDS)
    ids = options.ids or IDS
    timer = (port.latency_ms or 0) * 1e-3

    def open_prober(baud: int) -> PortProber:
        port.set_baud(baud)
        return PortProber(port, clock, baud, timer=timer)

    seconds = sum(estimate(baud, ids, thorough=options.thorough, timer=timer) for baud in bauds)
    _begin(options, port, bauds, ids, seconds)
    rates = []
    with ProgressLine(options, "scan", seconds=seconds, now=clock.now) as progress:
        tell = partial(_report_progress, progress)
        for rate in scan(open_prober, bauds, ids, thorough=options.thorough, tell=tell):
            progress.clear()
            rates.append(rate)
            _show(options, rate)
    found = [each for rate in rates for each in rate.found]
    if not found:
        more = " Without --baud all rates are searched." if options.baud else ""
        raise Rejected(f"{port.name}: no device answers: is the power on, and the data line connected?{more}")
    return REFUSED if any(each.trouble for each in found) else DONE


def _report_progress(progress: ProgressLine, baud: int, what: str) -> None:
    progress.update(f"{baud} baud: {what}")


def _begin(
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
    says = f"{port.name}: ids {min(ids)} to {max(ids)} at {rates}, about {seconds:.0f} s"
    print(says, file=sys.stderr, flush=True)
    if port.warning:
        print(f"{port.name}: {port.warning}", file=sys.stderr, flush=True)


def _show(options: argparse.Namespace, rate: BaudRateScan) -> None:
    """Print one rate: a line of JSON or text per device, then the troubles of the line."""
    for each in rate.found:
        print(json.dumps(asdict(each) | _trouble(each)) if options.json else _text(each), flush=True)
    for trouble in rate.troubles:
        text = {"baud": rate.baud, "trouble": str(trouble)}
        print(json.dumps(text) if options.json else f"{rate.baud:>7} baud  {trouble}", flush=True)


def _trouble(each: ScannedDevice) -> dict[str, str]:
    """Format a trouble as text, in JSON too; "" where there is none."""
    return {"trouble": str(each.trouble) if each.trouble else ""}


def _text(each: ScannedDevice) -> str:
    model = each.model_name or ("unknown" if each.model is None else f"model {each.model}")
    words = [f"{each.baud:>7} baud", f"id {each.id:>3}", model]
    if each.firmware is not None:
        words.append(f"firmware {each.firmware}")
    if each.torque is not None:
        words.append(f"torque {'on' if each.torque else 'off'}")
    if each.hardware_error:
        bits = [name for bit, name in BITS.items() if each.hardware_error >> bit & 1]
        words.append(f"hardware error: {', '.join(bits) or f'{each.hardware_error:#04x}'}")
    return "  ".join([*words, *([str(each.trouble)] if each.trouble else [])])
