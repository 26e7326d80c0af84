"""Configure a new serial servo as the missing one of the robot file.

For servos with factory settings (usually id 1) on the robot's bus. This process opens the
port, so the daemon must be stopped. The servo gets its id, the bus's rate and the registers that robot file
and daemon require, each read back; torque stays off. After an interruption the same command completes the
work.
"""

import argparse

from twind_calibration.robot_description import add_arguments as add_files

group = "set up"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.add_argument("joint", nargs="?", metavar="JOINT", help="default: the only one without a servo")
    parser.add_argument("--yes", action="store_true", help="do not ask before writing")
    parser.add_argument("--dry-run", action="store_true", help="print what would be written, write nothing")
    add_files(parser)


def run(options: argparse.Namespace) -> int:
    """Exit code 0: it answers at its place and holds what it must (or would, with --dry-run)."""
    from twind_calibration.family_verbs import adopt  # 0.5 s of imports that the list of verbs need not pay

    return adopt(options)
