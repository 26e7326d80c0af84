"""show a robot file in the browser, joint by joint

It has id, limits, axis and sign of each joint; a slider shows which way is positive. It needs no daemon.
With --live the angles are those of the daemon that mirrors the limp robot.
"""

import argparse
from contextlib import closing

import msgspec

from twind.command_line.verb import Rejected, UsageError
from twind.config.yaml_tree import ConfigError
from twind.exceptions import InvalidInput
from twind.observe.view import needed

group = "set up"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the step."""
    parser.add_argument("robot", metavar="FILE|NAME", help="robot file, or the name of a built-in robot")
    parser.add_argument("--live", action="store_true", help="angles from the running daemon, no sliders")
    parser.add_argument("--port", type=int, metavar="N", help="of 127.0.0.1 (default: the first free one)")
    parser.add_argument("--open", action="store_true", help="open the page in your browser")


def run(options: argparse.Namespace) -> int:
    """Until Ctrl-C or SIGTERM: 0. Raises UsageError, Rejected, ClientError."""
    needed(options.port)
    from twind.config.robot_file import load_robot
    from twind.observe.viewing.model_run import show_model
    from twind.observe.viewing.robot_connections import local, observer
    from twind.twin.binding import bind

    try:
        robot = load_robot(options.robot)
        mjcf = bind(robot, None).mjcf  # with what it includes
    except InvalidInput as error:
        raise UsageError(str(error)) from None
    except ConfigError as error:
        raise Rejected(str(error)) from None
    description = {"robot": msgspec.to_builtins(robot, enc_hook=str), "mjcf": mjcf}
    ways = local(options.socket) if options.live else None
    if ways is not None:
        with closing(observer(ways, 5.0)) as client:
            client.call("GetStatus")  # without a daemon this fails now
    return show_model(description, ways, port=options.port, open_page=options.open, as_json=options.json)
