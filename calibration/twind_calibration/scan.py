"""Scan a bus for devices, through the daemon or on a free port.

Without `--port` the daemon queries the ids of its robot file. With `--port` this process opens the port and
queries every id at every baud rate. Nothing is written to any servo.
"""

import argparse
import json
import re

from twind.command_line.progress import ProgressLine
from twind.command_line.verb import DONE, UsageError, operator

group = "set up"

LAST_ID = 253  # of any family


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.add_argument("bus", nargs="?", help="which bus (default: the only one)")
    alone = parser.add_argument_group("on a port that no daemon holds")
    alone.add_argument("--port", help="serial port to scan, instead of the daemon's buses")
    alone.add_argument(
        "--kind", help="only devices of this kind of bus, such as dynamixel2, dynamixel1 or feetech"
    )
    alone.add_argument("--baud", type=int, nargs="+", metavar="N", help="only these rates")
    alone.add_argument("--ids", type=ids_of, metavar="A-B", help=f"only these ids (default 0-{LAST_ID})")
    alone.add_argument(
        "--thorough", action="store_true", help="query each id once more: finds lost packets, slow"
    )


def run(options: argparse.Namespace) -> int:
    """Exit code 0: a device was found, and no device has a fault."""
    if options.port is None:
        if options.kind or options.baud or options.ids or options.thorough:
            raise UsageError(
                "--kind, --baud, --ids and --thorough need --port PORT: the daemon knows its own buses"
            )
        return _scan(options)
    if options.bus is not None:
        raise UsageError(f"either the bus {options.bus!r} of the daemon or --port {options.port}, not both")
    from twind_calibration.family_verbs import scan  # 0.2 s of imports that asking the daemon need not pay

    return scan(options)


def _scan(options: argparse.Namespace) -> int:
    """Print the devices that the daemon finds on its buses."""
    with operator(options) as client, ProgressLine(options, "scan") as progress:
        client.timeout = 65.0
        progress.update("searching")
        for count, found in enumerate(client.stream("Scan", bus=options.bus), 1):
            if options.json:
                print(json.dumps(found), flush=True)
                continue
            model = found.get("model_name") or f"model {found['model']}"
            progress.clear()
            print(
                f"{found['bus']}  id {found['id']:>3}  {model}  firmware {found.get('firmware', '-')}",
                flush=True,
            )
            progress.update(f"{count} answered")
    return DONE


def ids_of(text: str) -> range:
    """ "3" or "1-24" as ids. Raises argparse.ArgumentTypeError that names the bounds."""
    match = re.fullmatch(r"([0-9]{1,3})(?:-([0-9]{1,3}))?", text)
    first, last = (int(match[1]), int(match[2] or match[1])) if match else (1, 0)
    if not 0 <= first <= last <= LAST_ID:
        raise argparse.ArgumentTypeError(f"{text!r} is not A or A-B with 0 <= A <= B <= {LAST_ID}")
    return range(first, last + 1)
