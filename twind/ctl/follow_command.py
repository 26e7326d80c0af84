"""Have a robot follow another that is moved by hand, through its gate.

LEADER and FOLLOWER are folders of sockets, or instances as of -i. The leader is only read: leave it limp, in
mode mirror, or in live before arming. The follower must be armed; it first moves slowly to the leader's pose.
When a reading of the leader is older than 0.1 s, it decelerates and holds, and the command ends.
"""

import argparse

group = "drive"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments: both robots and the mapping of their joints."""
    parser.add_argument("leader", metavar="LEADER", help="the robot that is read")
    parser.add_argument("follower", metavar="FOLLOWER", help="the robot that moves")
    for name, form, text in (
        ("map", "LEADER=FOLLOWER", "joint of the leader for a joint of the follower; others by their name"),
        ("scale", "JOINT=FACTOR", "factor of a joint of the follower; negative mirrors"),
        ("offset", "JOINT=RAD", "added to a joint of the follower, rad"),
    ):
        parser.add_argument(
            f"--{name}", action="append", default=[], metavar=form, help=f"{text}; repeatable"
        )
    parser.add_argument("--rate", type=float, default=100.0, metavar="HZ", help="rate of goals (default 100)")
    parser.add_argument("--take", action="store_true", help="take the lease from its present holder")


def run(options: argparse.Namespace) -> int:
    """1 when the leader is lost; Ctrl-C ends it otherwise."""
    from twind.ctl.following.follow_session import follow  # numpy: no other verb pays for it

    return follow(options)
