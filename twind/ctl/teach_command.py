"""Record a motion while a hand guides limp joints; `play` plays it.

Enter begins and ends the recording; with --seconds it begins at once. Ctrl-C ends it too and keeps what was
recorded. The motion is simplified, and moved into the limits and slowed down where the gate needs it. A
joint's path counts at equal time. Torque stays off: teach in mode mirror, or in live before arming.
"""

import argparse
from math import inf

from twind.ctl.teaching.key_input import KeyInput

group = "drive"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments: the motion's name, its joints, and how it is recorded."""
    parser.add_argument("motion", metavar="FILE|NAME", help="the motion to write; a name is the robot's own")
    parser.add_argument("--joints", metavar="NAME,...", help="only these; * and ? are allowed (default: all)")
    parser.add_argument("--seconds", type=_seconds, metavar="S", help="begin at once, end after S s")
    parser.add_argument(
        "--bound",
        type=_seconds,
        default=0.01,
        metavar="RAD",
        help="largest distance from the hand's path by simplification, rad (default 0.01)",
    )
    parser.add_argument("--force", action="store_true", help="replace the motion if there is one")
    parser.add_argument("--take", action="store_true", help="take the lease from its present holder")


def run(options: argparse.Namespace) -> int:
    """0 when the whole motion is written and the gate accepts it."""
    from twind.ctl.teaching.teach_session import teach  # numpy: no other verb pays for it

    with KeyInput() as keys:
        return teach(options, keys)


def _seconds(text: str) -> float:
    """A positive number. Raises ArgumentTypeError."""
    try:
        value = float(text)
    except ValueError:
        value = -inf
    if not 0.0 < value < inf:
        raise argparse.ArgumentTypeError(f"{text!r} is no number above 0")
    return value
