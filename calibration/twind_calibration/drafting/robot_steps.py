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
_FINISH = """\
settle the open items of a robot file, one by one

Signs: the daemon mirrors the limp robot (`twind --mode mirror`), and each joint is moved by hand in its
positive direction. Limits: from the calibration file, after `twindctl calibrate sweep` and `zero`. Rest pose:
the limp robot as it lies. Each answer is written at once; the same command goes on where it ended.
"""


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
    parser.add_argument(
        "--from",
        dest="files",
        action="append",
        default=[],
        metavar="FILE",
        help="file of other software with ids, models, limits or signs; may be repeated",
    )
    parser.add_argument("--model", metavar="FILE", help="MJCF, URDF or xacro; without one: joints alone")
    parser.add_argument(
        "--package",
        dest="packages",
        action="append",
        default=[],
        metavar="NAME=DIR",
        help="folder of a ROS package that the model names",
    )
    parser.add_argument(
        "--argument",
        dest="arguments",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="of a xacro file",
    )
    parser.add_argument("--mapping", metavar="FILE", help="how to read --from files of an unknown format")
    parser.add_argument(
        "--port",
        dest="ports",
        action="append",
        default=[],
        metavar="BUS=PORT",
        help="scan a port as this bus",
    )
    parser.add_argument(
        "--device",
        dest="devices",
        action="append",
        default=[],
        metavar="[NAME=]MODEL",
        help="model of a joint, of another software's name of a model, or of all joints without one",
    )
    parser.add_argument(
        "--joint",
        dest="names",
        action="append",
        default=[],
        metavar="OLD=NAME",
        help="name of a joint in place of that of a source; scanned devices are BUS_ID, such as main_3",
    )
    parser.add_argument(
        "--bus", dest="buses", action="append", default=[], metavar="JOINT=BUS", help="bus of a joint"
    )
    _answer_arguments(parser)


def _finish_arguments(parser: argparse.ArgumentParser) -> None:
    _answer_arguments(parser)
    add_files(parser)


STEPS = {
    "new": VerbStep(_NEW, _new_arguments, "drafting.new_command:write_new"),
    "finish": VerbStep(_FINISH, _finish_arguments, "drafting.finish_command:finish"),
}
