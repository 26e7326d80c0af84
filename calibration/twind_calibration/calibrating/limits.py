"""the last fence: a servo's own position limits set to those of its joint

For joints in mode position: Max and Min Position Limit (48, 52) become the joint's limits in counts, rounded
inwards. Shown, asked for, written with torque off, read back, and recorded in the calibration file. Needs the
daemon in mode live, disarmed.
"""

import argparse

from twind_calibration.calibrating.file_option import add_arguments as add_common


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the step."""
    parser.add_argument("joints", nargs="*", metavar="JOINT", help="default: all that are calibrated")
    parser.add_argument("--yes", action="store_true", help="do not ask before writing")
    parser.add_argument("--take", action="store_true", help="take the lease from its present holder")
    add_common(parser)


def run(options: argparse.Namespace) -> int:
    """Exit code 0: every joint that was asked for has its fence."""
    from twind_calibration.calibrating.limits_command import (
        limits,  # imports that the list of steps need not pay
    )

    return limits(options)
