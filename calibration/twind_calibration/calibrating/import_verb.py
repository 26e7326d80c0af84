"""what others measured: a servo's own registers, or a LeRobot calibration, folded in exactly

Nothing is written to a servo: what is there is kept, recorded, and counted with. The travel is the range of
the file, or what was swept, else the servo's own position limits; the zero is where you say it is. Check with
`prove` afterwards.
"""

import argparse

from twind_calibration.calibrating.file_option import add_arguments as add_common

KINDS = ("servo", "lerobot")
MAKES = ("dynamixel", "feetech")
MIDDLE = "middle"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the step."""
    parser.add_argument("joints", nargs="*", metavar="JOINT", help="default: all that the source knows")
    parser.add_argument(
        "--from", dest="kind", required=True, choices=KINDS, help="registers, or a LeRobot file"
    )
    parser.add_argument("--file", metavar="FILE", help="of --from lerobot: its calibration, JSON")
    parser.add_argument(
        "--make",
        choices=MAKES,
        help="of the servos of the file, if their homing offset is another one now",
    )
    parser.add_argument("--map", metavar="FILE", help="lines `MOTOR: JOINT` (default: by id)")
    parser.add_argument(
        "--zero-at",
        action="append",
        required=True,
        type=_zero_at,
        metavar="[JOINT=]TICKS|middle",
        help="count at joint angle 0, as the source counts, or the middle of the travel; may be repeated",
    )
    parser.add_argument("--wide", action="store_true", help="take travels over 130 %% of the described range")
    parser.add_argument("--yes", action="store_true", help="do not ask before writing")
    add_common(parser)


def run(options: argparse.Namespace) -> int:
    """Exit code 0: every joint that was asked for is in the file."""
    from twind_calibration.calibrating.import_command import (
        take,  # imports that the list of steps need not pay
    )

    return take(options)


def _zero_at(text: str) -> tuple[str, int | None]:
    """ "2048", "l_knee=2051", "middle" -> joint ("": all) and count. Raises ArgumentTypeError."""
    name, found, value = text.rpartition("=")
    if value == MIDDLE and bool(name) == bool(found):
        return name, None
    try:
        ticks = int(value)
    except ValueError:
        ticks = 1 << 40
    if bool(name) != bool(found) or abs(ticks) > 1 << 31:
        raise argparse.ArgumentTypeError(f"{text!r} is not TICKS, middle, JOINT=TICKS or JOINT=middle")
    return name, ticks
