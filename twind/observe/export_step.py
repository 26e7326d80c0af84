"""write a robot for other software

--urdf prints the URDF for ROS, with joint names and limits of the robot file. --mjcf writes MuJoCo's model
with the identified parameters, for a trainer. No daemon is needed.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import msgspec

from twind.command_line.verb import Rejected, UsageError
from twind.config.robot_spec import RobotFile
from twind.config.yaml_tree import ConfigError
from twind.exceptions import InvalidInput

group = "set up"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the step."""
    parser.add_argument("robot", metavar="FILE|NAME", help="robot file, or the name of a built-in robot")
    form = parser.add_mutually_exclusive_group(required=True)
    form.add_argument("--urdf", action="store_true", help="print the robot as URDF")
    form.add_argument("--mjcf", metavar="OUT", type=Path, help="write the model and its meshes to OUT")
    parser.add_argument(
        "--identified",
        metavar="FILE",
        help="identified model for --mjcf; default: NAME.identified.yaml beside the calibration",
    )


def run(options: argparse.Namespace) -> int:
    """Print or write the robot; return 0. Raises UsageError, Rejected."""
    from twind.config.robot_file import load_robot
    from twind.observe.describing.mjcf_writer import write_mjcf
    from twind.observe.describing.robot_frames import robot_tree
    from twind.observe.describing.urdf_writer import urdf_text
    from twind.twin.binding import bind

    try:
        robot = load_robot(options.robot)
        if options.mjcf is not None:
            write_mjcf(_identified(robot, options.identified), options.mjcf)
        else:
            plain = msgspec.to_builtins(robot, enc_hook=str)
            sys.stdout.write(urdf_text(robot_tree(bind(robot, None).model, plain), plain))
    except (ConfigError, OSError) as error:
        raise Rejected(str(error)) from None
    except InvalidInput as error:
        raise UsageError(str(error)) from None
    return 0


def _identified(robot: RobotFile, named: str | None) -> RobotFile:
    """Return the robot with the identified model that is named, else with that of its calibration, if any."""
    from twind.config.config_files import overlay_path
    from twind.config.daemon_settings import load_settings
    from twind.config.identified_file import load_identified

    path = overlay_path(load_settings(None), robot.name, named)
    if named is None and not path.is_file():
        print(f"twindctl: {path} does not exist: the model as the robot file has it", file=sys.stderr)
        return robot
    return replace(robot, identified=load_identified(path, robot))
