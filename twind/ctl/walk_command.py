"""Walk a robot of two six-joint legs at a velocity, then stand.

The robot stands on its own feet and is armed. An engine plans feet and centre of mass and balances by the
IMU; its goals pass the gate as those of any client. Ctrl-C: it walks on to a stance. `twindctl stop` ends the
goals at once. If the robot falls it is stopped by an e-stop.
"""

import argparse
from importlib.util import find_spec

from twind.command_line.extras import how_to_add
from twind.command_line.stop_signals import catch_stop_signals
from twind.command_line.verb import DONE, Rejected, UsageError, show

group = "drive"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments: velocity and time."""
    parser.add_argument("--forward", type=float, default=0.0, metavar="M_S", help="m/s, -0.12 to 0.12")
    parser.add_argument("--left", type=float, default=0.0, metavar="M_S", help="m/s, -0.03 to 0.03")
    parser.add_argument(
        "--turn", type=float, default=0.0, metavar="RAD_S", help="rad/s to the left, -0.25 to 0.25"
    )
    parser.add_argument("--seconds", type=float, metavar="S", help="stop by itself (default: at Ctrl-C)")
    parser.add_argument("--take", action="store_true", help="take the lease from its present holder")


def run(options: argparse.Namespace) -> int:
    """0 when the robot stands again. Raises UsageError, Rejected, ClientError."""
    if find_spec("mink") is None:
        raise UsageError(f"walk needs mink: {how_to_add('walk')}")
    from twind.exceptions import InvalidInput
    from twind.robot_client.robot import Robot

    velocity = (options.forward, options.left, options.turn)
    with catch_stop_signals() as ended, Robot(options.socket, take=options.take, state_rate=100.0) as robot:
        try:
            outcome = robot.walk(
                seconds=options.seconds, command=lambda now: None if ended.is_set() else velocity
            )
        except InvalidInput as error:
            raise Rejected(str(error)) from None
    text = f"{outcome.steps} steps in {outcome.seconds:.1f} s, {outcome.refused} goals refused; it stands"
    show(options, {"steps": outcome.steps, "seconds": outcome.seconds, "refused": outcome.refused}, text)
    return DONE
