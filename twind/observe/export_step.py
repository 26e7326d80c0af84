"""write a robot for other software

--urdf prints the URDF for ROS, with joint names and limits of the robot file. No daemon is needed.
"""

import argparse
import sys

import msgspec

from twind.command_line.verb import Rejected, UsageError
from twind.config.yaml_tree import ConfigError
from twind.exceptions import InvalidInput

group = "set up"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the step."""
    parser.add_argument("robot", metavar="FILE|NAME", help="robot file, or the name of a built-in robot")
    form = parser.add_mutually_exclusive_group(required=True)
    form.add_argument("--urdf", action="store_true", help="print the robot as URDF")


def run(options: argparse.Namespace) -> int:
    """Print the robot; return 0. Raises UsageError, Rejected."""
    from twind.config.robot_file import load_robot
    from twind.observe.describing.robot_frames import robot_tree
    from twind.observe.describing.urdf_writer import urdf_text
    from twind.twin.binding import bind

    try:
        robot = load_robot(options.robot)
        plain = msgspec.to_builtins(robot, enc_hook=str)
        sys.stdout.write(urdf_text(robot_tree(bind(robot, None).model, plain), plain))
    except ConfigError as error:
        raise Rejected(str(error)) from None
    except InvalidInput as error:
        raise UsageError(str(error)) from None
    return 0
