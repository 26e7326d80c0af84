"""Steps of `twindctl calibrate`: help, options, and the function that runs each.

The functions are imported when a step runs: their imports take up to a second, which the list need not pay.
"""

import argparse
import math
import shlex

from twind_calibration.robot_description import add_arguments as add_files
from twind_calibration.verb_step import VerbStep

# degrees of `prove`
LEAST = 3.0
MOST = 45.0

KINDS = ("servo", "lerobot")
MAKES = ("dynamixel", "feetech")
MIDDLE = "middle"
WHICH = "a number, `current`, or a path"


def format_option(options: argparse.Namespace) -> str:
    """Return `--calibration` as text for the next command; empty where it was not given."""
    return f" --calibration {shlex.quote(options.calibration)}" if options.calibration else ""


def _add_file(parser: argparse.ArgumentParser) -> None:
    """Add `--calibration FILE`, the option of every step that writes the calibration file."""
    parser.add_argument(
        "--calibration", metavar="FILE", help="the file to write (default: the one that the daemon reads)"
    )


def _sweep_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("joints", nargs="*", metavar="JOINT", help="default: all that have no travel yet")
    parser.add_argument("--again", action="store_true", help="include joints that are already swept")
    parser.add_argument("--wide", action="store_true", help="take travels over 130 %% of the described range")
    parser.add_argument("--timeout", type=float, metavar="S", help="end after so long with what is done")
    parser.add_argument("--take", action="store_true", help="take the lease from its present holder")
    _add_file(parser)


def _seal_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", metavar="FILE", help="calibration file; written anew")
    parser.add_argument("--config", metavar="FILE", help="settings of the daemon (default: its usual place)")
    parser.add_argument("--robot", metavar="NAME|FILE", help="instead of the robot of the settings")
    parser.add_argument("--yes", action="store_true", help="do not ask before writing")
    parser.set_defaults(port=[], calibration=None)


def _zero_arguments(parser: argparse.ArgumentParser) -> None:
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
    _add_angles(parser)
    parser.add_argument("--samples", type=_samples, default=50, metavar="N", help="readings (default 50)")
    parser.add_argument("--yes", action="store_true", help="it stands in the pose: do not ask, and write")
    parser.add_argument("--take", action="store_true", help="take the lease from its present holder")
    _add_file(parser)


def _endstop_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("joint", metavar="JOINT", help="the joint to drive")
    _add_search(parser)
    parser.add_argument(
        "--yes", action="store_true", help="it may move now: do not ask, and write what was found"
    )
    parser.add_argument("--take", action="store_true", help="take the lease from its present holder")
    _add_file(parser)


def _add_angles(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--at",
        action="append",
        default=[],
        type=_angle,
        metavar="JOINT=RAD",
        help="angle of a joint that differs from the pose; may be repeated",
    )


def _add_search(parser: argparse.ArgumentParser) -> None:
    """Add the options of a motion against a stop."""
    parser.add_argument(
        "--side",
        choices=("lower", "upper"),
        help="which of its stops (default: `homing.side` of the robot file, else the one that is described)",
    )
    parser.add_argument(
        "--current", type=float, metavar="A", help="most current (default: `homing.current_a`, else 12 %%)"
    )
    parser.add_argument("--speed", type=float, metavar="RAD/S", help="of the joint (default 0.2)")
    parser.add_argument("--times", type=int, metavar="N", help="touches of the stop, 2 to 10 (default 3)")


def _turn_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("joints", nargs="+", metavar="JOINT", help="joints whose turn is unknown")
    parser.add_argument("--pose", metavar="NAME", help="they stand in this pose of the robot file")
    _add_angles(parser)
    parser.add_argument(
        "--endstop", action="store_true", help="drive one joint against its stop instead, powered"
    )
    _add_search(parser)
    parser.add_argument("--yes", action="store_true", help="it stands so, or may move now: do not ask")
    parser.add_argument("--take", action="store_true", help="take the lease from its present holder")
    _add_file(parser)


def _prove_arguments(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("joints", nargs="*", metavar="JOINT", help="default: every joint")
    add("--base", metavar="POSE", help="how the base is held: upright, back, front, left or right")
    add("--plan", action="store_true", help="print which base pose proves which joint; nothing moves")
    add("--robot", metavar="NAME|FILE", help="with --plan: of this robot; no daemon is asked")
    add("--pose", metavar="NAME", help="go to this pose of the robot file first, and back at the end")
    add("--with", action="append", default=[], dest="bends", metavar="JOINT=RAD", help="likewise one joint")
    add("--degrees", type=float, default=15.0, metavar="N", help="how far either way, 3 to 45 (default 15)")
    add("--friction", type=float, default=0.1, metavar="N·m", help="of a joint, at least (default 0.1)")
    add("--arm", action="store_true", help="arm first if the robot is not; it stays armed")
    add("--take", action="store_true", help="take the lease from its present holder")
    add("--yes", action="store_true", help="it is held so, nothing is in its limbs' way: do not ask")
    add("--no-ask", action="store_true", help="do not ask what was seen")
    _add_file(parser)


def _import_arguments(parser: argparse.ArgumentParser) -> None:
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
    _add_file(parser)


def _limits_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("joints", nargs="*", metavar="JOINT", help="default: all that are calibrated")
    parser.add_argument("--yes", action="store_true", help="do not ask before writing")
    parser.add_argument("--take", action="store_true", help="take the lease from its present holder")
    _add_file(parser)


def _show_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("which", nargs="?", default="current", metavar="N", help=WHICH)
    add_files(parser)


def _diff_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("before", nargs="?", metavar="A", help=f"{WHICH} (default: the latest)")
    parser.add_argument("after", nargs="?", default="current", metavar="B", help="(default: current)")
    add_files(parser)


def _rollback_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("which", metavar="N", help="number of the file to put back")
    parser.add_argument("--yes", action="store_true", help="do not ask before writing")
    add_files(parser)


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


_SCAN = """\
scan the buses and compare the devices with the files

Through the running daemon, or without one on the free ports. Wrong models, missing and unknown devices, ids
that answer twice, registers that differ: all are listed at once. Reads only."""

_SWEEP = """\
measure the travel: move joints by hand from end to end

Torque is off. A joint is done when it rested at both its ends, half a second each; ENTER ends with those that
are there. The travel goes into a draft beside the calibration file, until `zero` makes it whole. Arming is
refused meanwhile, and the mode stays. A joint that is swept again loses its earlier travel at once. Ctrl-C
keeps the finished joints and prints the command that continues."""

_ZERO = """\
measure where angle 0 is: hold the robot in a known pose

Sweep first: only so is it known on which turn a reading lies. Each joint is read 50 times; readings that
spread by more than 3 ticks do not count. What is whole, travel and zero, goes into the calibration file, and
the earlier file is kept beside it. Torque stays off."""

_ENDSTOP = """\
refine the zero: drive one joint against its stop, powered

That joint alone moves by itself, all others are limp: the robot must hang, lie or be held, and all persons
stay clear of it. It needs a coarse calibration of the joint, `stop_rad` in the robot file, a
serial servo that has current-based position, and the daemon in live. Ctrl-C, `twindctl estop` and `twindctl
disarm` end it at once. Whatever ends it, torque goes off and the servo is set as it was."""

_TURN = """\
tell on which motor turn a joint stands

For a joint that may travel more than a turn of its motor, where its count fits several turns. By a pose that
you see, or with --endstop by a motion: that joint alone moves by itself against its stop and away from it, as
`endstop` does and says. Nothing is written to the calibration file."""

_PROVE = """\
compare signs and zeros with the model by small moves against gravity

Through the running daemon in live, its gate and the lease, one joint after the other, each place come to from
both sides. You say how the base is held. Where a wrong sign would feel the same, the joint is reported as
unobservable: --plan says which base pose, and which angles of its neighbours, show it."""

_IMPORT = """\
import from servo registers or a LeRobot file, instead of sweep and zero

Nothing is written to a servo: what is there is kept, recorded, and counted with. The travel is the range of
the file, or what was swept, else the servo's own position limits; the zero is where you say it is. Check with
`prove` afterwards."""

_HISTORY = """

Calibration files are numbered, and 20 are kept. `current` is the file in force; a path names any other. No
daemon is needed; a running daemon names its file, else the settings do."""

_LIMITS = """\
set the position limits in the servos

For joints in mode position: the limit registers become the joint's limits in counts, rounded
inwards. Shown, asked for, written with torque off, read back, and recorded in the calibration file. Needs the
daemon in mode live, disarmed."""

_SEAL = """\
complete and hash a calibration file that was written or edited by hand

Each joint needs `zero_ticks` and `sweep_ticks`; the rest follows from the robot file, and a missing `device`
from the running daemon. The earlier file is kept. Nothing proves a zero written by hand; `prove` proves the
sign."""


STEPS = {
    "scan": VerbStep(_SCAN, add_files, "calibrating.calibrate_scan_command:scan"),
    "sweep": VerbStep(_SWEEP, _sweep_arguments, "calibrating.sweep_command:sweep"),
    "zero": VerbStep(_ZERO, _zero_arguments, "calibrating.zero_command:zero"),
    "endstop": VerbStep(_ENDSTOP, _endstop_arguments, "calibrating.endstop_command:endstop"),
    "turn": VerbStep(_TURN, _turn_arguments, "calibrating.turn_command:turn"),
    "prove": VerbStep(_PROVE, _prove_arguments, "proving.prove_command:prove"),
    "import": VerbStep(_IMPORT, _import_arguments, "calibrating.import_command:take"),
    "show": VerbStep(
        "show the calibration file, or an earlier one" + _HISTORY,
        _show_arguments,
        "calibrating.history_command:show_file",
    ),
    "diff": VerbStep(
        "compare two calibration files" + _HISTORY, _diff_arguments, "calibrating.history_command:diff"
    ),
    "rollback": VerbStep(
        "restore an earlier calibration file" + _HISTORY,
        _rollback_arguments,
        "calibrating.history_command:rollback",
    ),
    "seal": VerbStep(_SEAL, _seal_arguments, "calibrating.seal_command:seal"),
    "limits": VerbStep(_LIMITS, _limits_arguments, "calibrating.limits_command:limits"),
}
