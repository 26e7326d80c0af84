"""scan the buses and compare the devices with robot file and calibration

Through the running daemon, or without one on the free ports. Wrong models, missing and unknown devices, ids
that answer twice, registers that differ: all are listed at once. Reads only.
"""

import argparse

from twind_calibration.robot_description import add_arguments as add_files


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the step, as `twindctl doctor` has them."""
    add_files(parser)


def run(options: argparse.Namespace) -> int:
    """Exit code 0: every device is present and as described."""
    from twind_calibration.calibrating.calibrate_scan_command import (
        scan,  # imports that the list of steps need not pay
    )

    return scan(options)
