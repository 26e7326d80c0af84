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
    parser.add_argument("--check", action="store_true")  # load all that is needed, and end
    options = parser.parse_args(words)
    if options.check:
        return _checked()
    log = BridgeLog()
    node = RclpyTransport(discovery(os.environ, domain=options.domain), log, sockets=options.socket)
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
        return bridge.run()


def _checked() -> int:
    """0; 2 and a line on standard error: a message package is missing."""
    try:
        check()
    except OperationFailed as error:
        print_line(str(error))
        return 2
    return 0
