"""Plot a recording: tracking, effort, gap, latency, temperature, supply, events.

Reads an .mcap or .flight file and writes a page of A4 as PNG. If there are many joints, those with the
largest errors are coloured, the others thin and grey. Unknown values are gaps. Torque from outside is drawn
where the daemon estimated it.
"""

import argparse
import re
from importlib.util import find_spec
from math import inf, isfinite
from pathlib import Path

from twind.command_line.extras import how_to_add
from twind.command_line.verb import DONE, Rejected, UsageError, show

group = "record"
unused_options = ("--socket",)  # it asks no daemon

PNG = b"\x89PNG\r\n\x1a\n"  # how such a file begins


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.add_argument("file", metavar="FILE", type=Path, help="an .mcap or .flight file")
    parser.add_argument(
        "--out",
        metavar="PNG",
        type=Path,
        help="where to (default: beside FILE, its name + .png); only a PNG is written over",
    )
    parser.add_argument(
        "--joints",
        metavar="NAME,...",
        help="the joints in colour, at most 8 (default: the six that are followed worst)",
    )
    parser.add_argument(
        "--from", dest="begin", type=seconds, default=-inf, metavar="S", help="s from the start"
    )
    parser.add_argument("--to", dest="end", type=seconds, default=inf, metavar="S", help="s from the start")


def run(options: argparse.Namespace) -> int:
    """Exit code 0: it is written. Raises UsageError, Rejected."""
    if find_spec("matplotlib") is None:
        raise UsageError(f"plot needs matplotlib: {how_to_add('plot')}")
    if not options.begin < options.end:
        raise UsageError(f"--from {options.begin:g} --to {options.end:g}: there is nothing between them")
    out = options.out or options.file.with_name(options.file.name + ".png")
    _spare(out)
    from twind.observe.plotting.plot_figure import figure, save
    from twind.observe.recording import open_recording

    recording = open_recording(options.file)
    chosen = None if options.joints is None else tuple(filter(None, re.split(r"[,\s]+", options.joints)))
    try:
        made = figure(recording, chosen, (options.begin, options.end))
    except ValueError as error:
        raise Rejected(f"{options.file}: {error}") from None
    try:
        save(made, out)
    except OSError as error:
        raise Rejected(f"{out}: {error.strerror or error}") from None
    damage = f" ({recording.damage})" if recording.damage else ""
    data = {"file": str(options.file), "out": str(out), "damage": recording.damage}
    show(options, data, f"{out}: {recording.duration:.1f} s of {len(recording.joints)} joints{damage}")
    return DONE


def _spare(out: Path) -> None:
    """Raises Rejected where something else than a picture would be lost: a recording above all."""
    try:
        if not out.exists():
            return
        if out.is_file():
            with out.open("rb") as file:
                if file.read(len(PNG)) == PNG:
                    return
    except OSError as error:
        raise Rejected(f"{out}: {error.strerror or error}") from None
    raise Rejected(f"{out}: there is something that is no PNG, and it stays; name another with --out")


def seconds(text: str) -> float:
    """A finite number. Raises ValueError, of which argparse makes a usage error."""
    value = float(text)
    if not isfinite(value):
        raise ValueError(text)
    return value
