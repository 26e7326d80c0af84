"""Program of the rclpy back end, started by the launcher under the distribution's interpreter; Python 3.10.

It uses the standard library and rclpy.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence

from twind.bridge.bridge_log import BridgeLog, print_line
from twind.bridge.ros.discovery import discovery
from twind.bridge.ros.rclpy_node import RclpyTransport, check
from twind.bridge.ros.ros_bridge import RosBridge
from twind.bridge.ros.ros_names import ROS_ARGS
from twind.command_line.stop_signals import catch_stop_signals
from twind.exceptions import OperationFailed


def main(words: Sequence[str]) -> int:
    """Run `twindctl ros --backend rclpy` behind the launcher; return the exit code."""
    parser = argparse.ArgumentParser(prog="twindctl ros")
    parser.add_argument("--socket")
    parser.add_argument("--rate", type=float)
    parser.add_argument("--domain", type=int)
    parser.add_argument("--describer")
    parser.add_argument("--no-commands", dest="commands", action="store_false")
    parser.add_argument(ROS_ARGS, nargs=argparse.REMAINDER, default=[])
    parser.add_argument("--check", action="store_true")  # load all that is needed, and end
    options = parser.parse_args(words)
    try:
        check(options.ros_args)
    except OperationFailed as error:
        print_line(str(error))
        return 2
    if options.check:
        return 0
    log = BridgeLog()
    graph = discovery(os.environ, domain=options.domain)
    node = RclpyTransport(graph, log, sockets=options.socket, arguments=options.ros_args)
    with catch_stop_signals() as stop, log.writing():
        bridge = RosBridge(
            node,
            sockets=options.socket,
            rate=options.rate,
            commands=options.commands,
            describer=options.describer,
            tell=log,
            stop=stop,
        )
        node.goals = bridge.commands.goal if options.commands else None
        node.settings = bridge.commands.settings
        return bridge.run()
