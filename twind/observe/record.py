"""Record the robot to .mcap files for Foxglove and ROS 2 tools.

Starts at once and runs until Ctrl-C, SIGTERM or --seconds. It only reads: it needs no lease, and the daemon
never waits for it. If the daemon restarts, it waits and continues in a new file.
"""

import argparse
import os
import time
from pathlib import Path

from twind.client.clock_pair import clocks
from twind.command_line.stop_signals import catch_stop_signals
from twind.command_line.verb import UsageError, observer
from twind.observe.writing.record_folder import DiskQuota
from twind.observe.writing.record_writer import RecordWriter
from twind.observe.writing.recorder import Recorder

group = "record"

_UNITS = {"": 1, "K": 1 << 10, "M": 1 << 20, "G": 1 << 30, "T": 1 << 40}


SIZES = (
    ("--max-size", "1G", "a new file begins at this size, at a quarter of --keep, or after an hour"),
    ("--keep", "10G", "what recordings may take in the folder: the oldest go first"),
    ("--free", "1G", "what stays free of the disk: recording stops there"),
)


def size(text: str) -> int:
    """Bytes of `500M` or `1.5G`; K, M, G and T are powers of 1024. Raises ArgumentTypeError."""
    word = text.strip().upper().removesuffix("B").removesuffix("I")
    number, unit = (word[:-1], word[-1]) if word[-1:] in ("K", "M", "G", "T") else (word, "")
    try:
        found = int(float(number) * _UNITS[unit])
    except (ValueError, OverflowError):
        raise argparse.ArgumentTypeError(f"{text!r} is no size; write 500M or 2G") from None
    if found < 0:
        raise argparse.ArgumentTypeError(f"{text!r} is less than nothing")
    return found


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `twindctl record`."""
    parser.add_argument("--out", metavar="DIR|FILE", type=Path, help="folder, or an .mcap file")
    parser.add_argument("--seconds", type=float, metavar="S", help="stop by itself")
    parser.add_argument("--task", metavar="T", help="mark all of it as an episode of this task")
    parser.add_argument("--per-episode", action="store_true", help="a file for each episode, nothing between")
    for name, usual, text in SIZES:
        parser.add_argument(
            name, type=size, default=size(usual), metavar="SIZE", help=f"{text} (default: {usual})"
        )


def run(options: argparse.Namespace) -> int:
    """Record; 1 when the disk stopped it."""
    if options.seconds is not None and not options.seconds > 0.0:
        raise UsageError(f"--seconds {options.seconds:g}: must be above 0")
    place = options.out if options.out is not None else usual_folder(options)
    folder = place.parent if place.suffix == ".mcap" else place
    if place.suffix == ".mcap" and place.exists():
        raise UsageError(f"{place}: is there already, and is never written over; name another file")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{folder}: {error.strerror}; name another folder with --out") from None
    bounds = DiskQuota(options.keep, options.free, options.max_size)
    with catch_stop_signals() as stop:
        writer = RecordWriter(place, bounds, time.monotonic, per_episode=options.per_episode, clocks=clocks)
        writer.start()
        try:
            return Recorder(options, writer, stop).run()
        finally:
            writer.close()


def usual_folder(options: argparse.Namespace) -> Path:
    """`recordings` below the daemon's state folder, or below this user's own where that is not for us."""
    from twind.config.daemon_settings import places

    with observer(options) as client:
        state = client.call("GetParameters")["parameters"].get("state_dir")
    if isinstance(state, str):
        folder = Path(state) / "recordings"
        nearest = folder if folder.exists() else folder.parent
        if os.access(nearest, os.W_OK | os.X_OK):
            return folder
    return places(os.environ, os.geteuid()).state / "recordings"
