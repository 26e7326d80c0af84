"""Propose gains and bounds.

`tune follow FILE`: how far each joint was behind its goal, and the keys follow_rad and follow_s that fit it,
with a margin of a quarter (FOLLOW_ERR). Reads an .mcap or .flight file of mode live. Faults are left out and
reported: a blocked joint is no reason for a wider bound. No file is written.

`tune gains JOINT ...`: steps joints of one type of the armed robot through the gate, tries other gains, and
proposes the best ones that do not overshoot. Between two tries the robot goes to its rest pose without
torque. It ends so, with the gains of the robot file; --write changes the file.
"""

import argparse
from pathlib import Path

from twind.command_line.verb import DONE, UsageError

group = "set up"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    add = parser.add_argument
    add("what", choices=["follow", "gains"], help="values to propose")
    add("named", nargs="+", metavar="FILE|JOINT", help="of follow a recording, of gains joints of one type")
    add("--step", type=float, default=0.15, metavar="RAD", help="of gains, at most (default 0.15)")
    add("--overshoot", type=float, default=0.1, metavar="SHARE", help="of the step, bound (default 0.1)")
    add("--tries", type=int, default=8, metavar="N", help="of gains, at most (default 8)")
    add("--write", action="store_true", help="write the proposed gains into the robot file, then reload it")
    add("--take", action="store_true", help="of gains: take the lease from its present holder")


def run(options: argparse.Namespace) -> int:
    """Exit code 0: the proposal is printed, and written if asked for. Raises Rejected, UsageError."""
    if options.what == "follow":
        from twind.observe.tuning.follow_table import show_follow

        if len(options.named) != 1 or options.write:
            raise UsageError("tune follow takes one recording, and writes nothing")
        show_follow(options, Path(options.named[0]))
    else:
        from twind.identification.tune_run import tune_gains

        tune_gains(options, options.named)
    return DONE
