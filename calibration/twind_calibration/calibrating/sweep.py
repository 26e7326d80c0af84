"""move each joint by hand from end to end: measures its travel

Torque is off. A joint is done when it rested at both its ends, half a second each; ENTER ends with those that
are there. The travel goes into a draft beside the calibration file, until `zero` makes it whole. Arming is
refused meanwhile, and the mode stays. A joint that is swept again loses its earlier travel at once. Ctrl-C
keeps the finished joints and prints the command that continues.
"""

import argparse

from twind_calibration.calibrating.file_option import add_arguments as add_common


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the step."""
    parser.add_argument("joints", nargs="*", metavar="JOINT", help="default: all that have no travel yet")
    parser.add_argument("--again", action="store_true", help="include joints that are already swept")
    parser.add_argument("--wide", action="store_true", help="take travels over 130 %% of the described range")
    parser.add_argument("--timeout", type=float, metavar="S", help="end after so long with what is done")
    parser.add_argument("--take", action="store_true", help="take the lease from its present holder")
    add_common(parser)


def run(options: argparse.Namespace) -> int:
    """Exit code 0: every joint that was asked for is swept."""
    from twind_calibration.calibrating.sweep_command import (
        sweep,  # imports that the list of steps need not pay
    )

    return sweep(options)
