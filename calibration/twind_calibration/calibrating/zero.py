"""where is joint angle 0: the robot held in a pose whose angles are known

Sweep first: only so is it known on which turn a reading lies. Each joint is read 50 times; readings that
spread by more than 3 ticks do not count. What is whole, travel and zero, goes into the calibration file, and
the earlier file is kept beside it. Torque stays off.
"""

import argparse
import math

from twind_calibration.calibrating.file_option import add_arguments as add_common


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the step."""
    parser.add_argument(
        "joints", nargs="*", metavar="JOINT", help="default: all that were swept and have no zero since"
    )
    parser.add_argument(
        "--all", action="store_true", help="include joints that have a zero; their proofs are deleted"
    )
    how = parser.add_mutually_exclusive_group()
    how.add_argument("--pose", metavar="NAME", help="pose of the robot file (default: every angle 0)")
    how.add_argument(
        "--from-sweep",
        action="store_true",
        help="by the ends of the travel instead: `stop_rad`, else the limits; coarse",
    )
    parser.add_argument(
        "--at",
        action="append",
        default=[],
        type=_angle,
        metavar="JOINT=RAD",
        help="angle of a joint that differs from the pose; may be repeated",
    )
    parser.add_argument("--samples", type=_samples, default=50, metavar="N", help="readings (default 50)")
    parser.add_argument("--yes", action="store_true", help="it stands in the pose: do not ask, and write")
    parser.add_argument("--take", action="store_true", help="take the lease from its present holder")
    add_common(parser)


def run(options: argparse.Namespace) -> int:
    """Exit code 0: every joint that was asked for has its zero, in the file."""
    from twind_calibration.calibrating.zero_command import zero  # imports that the list of steps need not pay

    return zero(options)


def _samples(text: str) -> int:
    """Raises ArgumentTypeError that names the bounds."""
    if not text.isdigit() or not 10 <= int(text) <= 10_000:
        raise argparse.ArgumentTypeError(f"{text!r} is not 10 to 10000")
    return int(text)


def _angle(text: str) -> tuple[str, float]:
    """ "l_knee=0.3". Raises ArgumentTypeError."""
    name, _, value = text.partition("=")
    try:
        angle = float(value)
    except ValueError:
        angle = math.nan
    if not name or not math.isfinite(angle):
        raise argparse.ArgumentTypeError(f"{text!r} is not JOINT=RAD")
    return name, angle
