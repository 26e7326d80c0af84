"""Identify servos, friction, inertia and links of a robot from its motion.

`identify FILE ...` reads recordings (.mcap, .flight) of mode live, or CSV of a servo that swings a mass.
`identify --live` moves the robot through the gate first. `identify show [FILE]` prints an identified model,
`identify diff FILE FILE` compares two. The result is judged on a quarter of the motion that the fit does not
see, and written only with --write, beside the calibration.
"""

import argparse
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from twind.command_line.extras import how_to_add
from twind.command_line.verb import DONE, UsageError

group = "set up"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    add = parser.add_argument
    add(
        "what",
        nargs="*",
        metavar="FILE|JOINT",
        help="recordings; with --live joints; or show, diff and files",
    )
    add("--live", action="store_true", help="excite the armed robot of the daemon: at most 15 min")
    add("--robot", metavar="NAME|FILE", help="robot file (default: the recorded robot)")
    add("--calibration", type=Path, metavar="FILE", help="its calibration, beside which --write writes")
    add("--write", action="store_true", help="write the identified model beside the calibration")
    add(
        "--amplitude",
        type=float,
        default=0.4,
        metavar="RAD",
        help="of --live, at most (default 0.4, up to 1.5)",
    )
    add("--take", action="store_true", help="of --live: take the lease from its present holder")
    add("--judge", nargs="+", default=[], type=Path, metavar="FILE", help="CSV that only judge the fit")
    add("--mass", type=float, metavar="KG", help="of a CSV: the mass that the servo swings")
    add("--length", type=float, metavar="M", help="of a CSV: the length of its arm")
    add("--kp", type=float, metavar="P", help="of a CSV: the P gain of the servo")


def run(options: argparse.Namespace) -> int:
    """Exit code 0: the result is printed, and written if asked for. Raises Rejected, UsageError."""
    words: list[Any] = options.what
    if words[:1] in (["show"], ["diff"]):
        from twind.identification.identified_table import compare_models, show_model

        (show_model if words[0] == "show" else compare_models)(options, [Path(word) for word in words[1:]])
        return DONE
    if not words and not options.live:
        raise UsageError("identify needs recordings, or --live")
    if find_spec("scipy") is None:
        raise UsageError(f"identify needs scipy: {how_to_add('identify')}")
    from twind.identification.identify_run import identify_files, identify_live, identify_pendulum

    if options.live:
        identify_live(options, words)
    elif all(word.endswith((".csv", ".csv.gz")) for word in words):
        identify_pendulum(options, [Path(word) for word in words])
    else:
        identify_files(options, [Path(word) for word in words])
    return DONE
