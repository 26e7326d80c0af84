"""small known moves against gravity: does the load say that sign and place are right

Through the running daemon in live, its gate and the lease, one joint after the other, each place come to from
both sides. You say how the base is held. Where a wrong sign would feel the same, the joint is told to be
unobservable: --plan says which base pose, and which angles of its neighbours, show it.
"""

import argparse

from twind_calibration.calibrating.file_option import add_arguments as add_common

# degrees
LEAST = 3.0
MOST = 45.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the step."""
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
    add_common(parser)


def run(options: argparse.Namespace) -> int:
    """Exit code 0: nothing contradicts; which joints are proved is told for each."""
    from twind_calibration.proving.prove_command import (
        prove,  # a second of imports that the list need not pay
    )

    return prove(options)
