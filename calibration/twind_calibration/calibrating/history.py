"""the calibration file and the earlier ones beside it: shown, compared, put back

They are numbered, 20 are kept. `current` is the file itself, and a path names any other. No daemon is needed;
one that runs says which file it reads, else the settings do.
"""

import argparse

from twind_calibration.robot_description import add_arguments as add_files

WHICH = "a number, `current`, or a path"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the step that `step` says: show, diff or rollback."""
    step = parser.get_default("step")
    if step == "show":
        parser.add_argument("which", nargs="?", default="current", metavar="N", help=WHICH)
    elif step == "diff":
        parser.add_argument("before", nargs="?", metavar="A", help=f"{WHICH} (default: the latest)")
        parser.add_argument("after", nargs="?", default="current", metavar="B", help="(default: current)")
    else:
        parser.add_argument("which", metavar="N", help="number of the file to put back")
        parser.add_argument("--yes", action="store_true", help="do not ask before writing")
    add_files(parser)


def run(options: argparse.Namespace) -> int:
    """Exit code 0: done."""
    from twind_calibration.calibrating.history_command import (
        STEPS,  # imports that the list of steps need not pay
    )

    return STEPS[options.step](options)
