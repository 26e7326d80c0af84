"""Move joints a little and back to verify that each follows.

Through the running daemon and its gate, one joint after the other. The encoder shows whether a joint
follows its goal. It cannot show the sign, the gear ratio or which joint moves, since goal and reading share
them. These are compared with the load that the model expects, where the pose shows it, and confirmed by
you.
"""

import argparse

group = "set up"

# degrees
LEAST = 0.5
MOST = 10.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb."""
    parser.add_argument("joints", nargs="*", metavar="JOINT", help="joints to move")
    parser.add_argument("--all", action="store_true", help="every joint, in the order of the robot file")
    parser.add_argument(
        "--degrees", type=float, default=2.0, metavar="N", help=f"how far, {LEAST:g} to {MOST:g} (default 2)"
    )
    parser.add_argument("--arm", action="store_true", help="arm first if the robot is not; it stays armed")
    parser.add_argument("--take", action="store_true", help="take the lease from its present holder")
    answers = parser.add_mutually_exclusive_group()
    answers.add_argument("--yes", action="store_true", help="you watch, and count every move as seen")
    answers.add_argument("--no-ask", action="store_true", help="do not ask what was seen")
    parser.add_argument(
        "--friction", type=float, default=0.1, metavar="N·m", help="of a joint, in the load (default 0.1)"
    )


def run(options: argparse.Namespace) -> int:
    """Exit code 0: every joint did what it should, as far as it can be told."""
    # A second of imports that the list of verbs need not pay.
    from twind_calibration.wiggling.joint_move import require_amounts
    from twind_calibration.wiggling.wiggle_command import wiggle

    require_amounts(options, LEAST, MOST)
    return wiggle(options)
