"""drive one joint against its stop, weakly and slowly: where its angle 0 is, by where its stop is described

Powered. That joint alone moves by itself, all others are limp: the robot must hang, lie or be held, and
all persons stay clear of it. It needs a coarse calibration of the joint, `stop_rad` in the robot file, a
serial servo that has current-based position, and the daemon in live. Ctrl-C, `twindctl estop` and `twindctl
disarm` end it at once. Whatever ends it, torque goes off and the servo is set as it was.
"""

import argparse

from twind_calibration.calibrating.file_option import add_arguments as add_common


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the step."""
    parser.add_argument("joint", metavar="JOINT", help="the joint to drive")
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
    parser.add_argument(
        "--yes", action="store_true", help="it may move now: do not ask, and write what was found"
    )
    parser.add_argument("--take", action="store_true", help="take the lease from its present holder")
    add_common(parser)


def run(options: argparse.Namespace) -> int:
    """Exit code 0: the stop was found, and the file has the zero that follows."""
    from twind_calibration.calibrating.endstop_command import endstop  # imports that the list need not pay

    return endstop(options)
