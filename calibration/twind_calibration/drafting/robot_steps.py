"""Steps of `twindctl robot`: help, options, and the function that runs each."""

import argparse

from twind_calibration.robot_description import add_arguments as add_files
from twind_calibration.verb_step import VerbStep

SUPPORTS = ("fixed", "gantry", "free")

_NEW = """\
write a robot file from scans, files of other software and a model

Sources are --from, --port and --model. Of limits the tighter one stays; sources that contradict each other
otherwise are refused. Known formats: LeRobot, Poppy and pypot, ROBOTIS framework, Interbotix, Reachy Mini,
ToddlerBot; --mapping describes any other. What no source states is written to the key `todo` of the file.
"""
_SERVO = """\
give servos on a port an id or a baud rate, before a robot file exists

Connect a new servo alone to give it its id: servos are delivered with the same one. Every write is read back;
torque must be off.
"""
_FINISH = """\
settle the open items of a robot file, one by one

Signs: the daemon mirrors the limp robot (`twind --mode mirror`), and each joint is moved by hand in its
positive direction. Limits: from the calibration file, after `twindctl calibrate sweep` and `zero`. Rest pose:
the limp robot as it lies. Each answer is written at once; the same command goes on where it ended.
"""


def _add_list(parser: argparse.ArgumentParser, option: str, name: str, metavar: str, text: str) -> None:
    """Add an option that may be repeated; its values are the list `name`."""
    parser.add_argument(option, dest=name, action="append", default=[], metavar=metavar, help=text)


def _answer_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--support", choices=SUPPORTS, help="what carries the robot")
    parser.add_argument(
        "--no-watchdog",
        action="store_true",
        help="accept servos that hold their last goal when the daemon dies",
    )


def _new_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("name", metavar="NAME", help="name of the robot: letters a to z, digits, _ and -")
    parser.add_argument("--folder", metavar="DIR", help="where to write (default: ./NAME); must not exist")
    _add_list(
        parser,
        "--from",
        "files",
        "[PREFIX=]FILE",
        "file of other software with ids, models, limits or signs; may be repeated; "
        "PREFIX begins the names of its joints and buses",
    )
    parser.add_argument("--model", metavar="FILE", help="MJCF, URDF or xacro; without one: joints alone")
    _add_list(parser, "--package", "packages", "NAME=DIR", "folder of a ROS package that the model names")
    _add_list(parser, "--argument", "arguments", "NAME=VALUE", "of a xacro file")
    parser.add_argument("--mapping", metavar="FILE", help="how to read --from files of an unknown format")
    _add_list(parser, "--port", "ports", "BUS=PORT", "scan a port as this bus")
    _add_list(
        parser,
        "--device",
        "devices",
        "[NAME=]MODEL",
        "model of a joint, of another software's name of a model, or of all joints without one",
    )
    _add_list(
        parser,
        "--joint",
        "names",
        "OLD=NAME",
        "name of a joint in place of that of a source; scanned devices are BUS_ID, such as main_3",
    )
    _add_list(parser, "--bus", "buses", "JOINT=BUS", "bus of a joint, or of all that a pattern matches")
    _add_list(parser, "--without", "without", "JOINT", "leave this joint out; a pattern such as 'sensor_*'")
    _answer_arguments(parser)


def _servo_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--port", required=True, metavar="PORT", help="serial port that no daemon holds")
    parser.add_argument(
        "--id", type=int, metavar="N", help="present id of the servo (default: all that answer)"
    )
    parser.add_argument("--new-id", type=int, metavar="N", help="its new id")
    parser.add_argument("--baud", type=int, metavar="RATE", help="new baud rate")
    parser.add_argument("--yes", action="store_true", help="do not ask before writing")


def _finish_arguments(parser: argparse.ArgumentParser) -> None:
    _answer_arguments(parser)
    add_files(parser)


STEPS = {
    "new": VerbStep(_NEW, _new_arguments, "drafting.new_command:write_new"),
    "servo": VerbStep(_SERVO, _servo_arguments, "family_verbs:relocate"),
    "finish": VerbStep(_FINISH, _finish_arguments, "drafting.finish_command:finish"),
}
