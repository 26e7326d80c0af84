"""Connect the robot to a ROS 2 graph: joint states out, trajectories in.

A client of observe.sock, and of control.sock for commands, which pass the gate as any other. With ROS it is
a node of the distribution's rclpy. Without ROS it uses Zenoh, or DDS, which only publishes. It stays on
this machine unless ROS_AUTOMATIC_DISCOVERY_RANGE or ROS_STATIC_PEERS say otherwise; ROS_DOMAIN_ID applies.
"""

from __future__ import annotations

import argparse
import os
import re
import sys
import threading
from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twind.bridge.bridge_log import BridgeLog, print_line
from twind.bridge.ros.backend_choice import DDS, RCLPY, ZENOH, usual
from twind.bridge.ros.ros_names import ROS_ARGS, node_name
from twind.command_line.extras import how_to_add
from twind.command_line.stop_signals import catch_stop_signals
from twind.command_line.verb import Rejected, UsageError
from twind.exceptions import InvalidInput, OperationFailed

if TYPE_CHECKING:
    from twind.bridge.commands.stop_queues import Tell
    from twind.bridge.ros.discovery import DiscoverySettings
    from twind.bridge.ros.ros_transport import RosTransport

group = "connect"

# name -> (what joins the graph, the modules that it needs)
BACK_ENDS = {
    DDS: ("twind.bridge.ros.dds:DdsTransport", ("cyclonedds",)),
    ZENOH: ("twind.bridge.ros.zenoh:ZenohTransport", ("zenoh", "xxhash")),
}
DISTROS = ("humble", "iron", "jazzy", "kilted", "lyrical", "rolling")
_ENDPOINT = re.compile(r"(?:tcp|tls|udp|quic|ws)/\S+:\d{1,5}(?:[?#]\S*)?|(?:unixsock-stream|serial)/\S+")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `twindctl ros`."""
    parser.add_argument(
        "--backend",
        choices=[RCLPY, *BACK_ENDS],
        help="what joins the graph; dds only publishes and takes no commands (default: rclpy where one is "
        "sourced, in /opt/ros or built by `make ros`; else zenoh where RMW_IMPLEMENTATION is rmw_zenoh_cpp; "
        "else dds)",
    )
    parser.add_argument("--domain", type=int, metavar="N", help="instead of ROS_DOMAIN_ID")
    parser.add_argument(
        "--distro", metavar="NAME", help="of the peers, instead of ROS_DISTRO (default jazzy)"
    )
    parser.add_argument("--rate", type=float, metavar="HZ", help="readings a second (default: the loop's)")
    parser.add_argument(
        "--no-commands",
        dest="commands",
        action="store_false",
        help="only publish; of the commands from ROS only the e-stop is accepted, with dds none",
    )
    parser.add_argument(
        "--no-tf",
        dest="tf",
        action="store_false",
        help="leave /robot_description, /tf and /tf_static to robot_state_publisher",
    )
    parser.add_argument(
        "--zenoh-connect", metavar="ENDPOINT", help="of the router (default tcp/localhost:7447)"
    )
    parser.add_argument("--zenoh-config", type=Path, metavar="FILE", help="configuration of the session")
    parser.add_argument(
        ROS_ARGS,
        nargs=argparse.REMAINDER,
        default=[],
        metavar="ARGUMENT",
        help="ROS's own arguments, after all others: -r __ns:=/left names a second robot in the domain",
    )


def run(options: argparse.Namespace) -> int:
    """Run the bridge until it is stopped, then return 0; 2 for a graph that the settings cannot name."""
    from twind.bridge.ros.discovery import discovery

    if options.rate is not None and not (isfinite(options.rate) and options.rate > 0.0):
        raise UsageError(f"--rate {options.rate:g}: must be above 0 Hz")
    try:
        graph = discovery(os.environ, domain=options.domain, distro=options.distro)
    except InvalidInput as error:
        raise UsageError(str(error)) from None
    options.backend = options.backend or usual(os.environ, options.distro, print_line)
    _sensible(options, graph)
    log = BridgeLog()
    with catch_stop_signals() as stop, log.writing():
        try:
            return _bridge(options, graph, stop, log)
        except OperationFailed as error:
            raise Rejected(str(error)) from None


def _sensible(options: argparse.Namespace, graph: DiscoverySettings) -> None:
    """Check the options that the own back ends would ignore; rclpy checks its own. Raises UsageError."""
    if options.backend != RCLPY and graph.distro not in DISTROS:
        raise UsageError(f"distribution {graph.distro!r}: must be one of {', '.join(DISTROS)}")
    endpoint = options.zenoh_connect
    if endpoint is not None and _ENDPOINT.fullmatch(endpoint) is None:
        raise UsageError(f"--zenoh-connect {endpoint}: expected tcp/HOST:PORT or tls/HOST:PORT")


def _bridge(
    options: argparse.Namespace, graph: DiscoverySettings, stop: threading.Event, log: BridgeLog
) -> int:
    if options.backend == RCLPY:
        from twind.bridge.ros.rclpy_launcher import launch

        print_line(_headline(options, graph))
        return launch(options, print_line)
    from twind.bridge.ros.ros_bridge import RosBridge

    transport = made(options, graph, log)
    print_line(_headline(options, graph, transport.refuses))
    bridge = RosBridge(
        transport,
        options.socket,
        rate=options.rate,
        commands=options.commands,
        describer=sys.executable if options.tf else None,
        tell=log,
        stop=stop,
    )
    return bridge.run()


def made(options: argparse.Namespace, graph: DiscoverySettings, tell: Tell) -> RosTransport:
    """The back end. Raises UsageError: a package is missing, or an argument of ROS is not supported."""
    where, needs = BACK_ENDS[options.backend]
    missing = [each for each in needs if find_spec(each) is None]
    if missing:
        words = f"--backend {options.backend} needs {' and '.join(missing)}: {how_to_add('ros')}"
        raise UsageError(f"{words}; where ROS is installed: --backend rclpy")
    module, _, name = where.partition(":")
    kind: Callable[..., Any] = getattr(import_module(module), name)
    node = node_name(options.ros_args)
    session = {"connect": options.zenoh_connect, "config": options.zenoh_config}
    transport: RosTransport = kind(graph, tell, name=node, **(session if options.backend == ZENOH else {}))
    return transport


def _headline(options: argparse.Namespace, graph: DiscoverySettings, refuses: str = "") -> str:
    """Return one line: back end, domain and reach of the bridge, and which hosts may command the robot.

    `refuses`: why the back end takes no commands.
    """
    from twind.bridge.commands.control_socket_access import denied
    from twind.client import Client

    # Named peers are only contacted first: any program that reaches the port joins.
    network = f"this network ({', '.join([graph.range.value, *graph.peers])})"
    reach = "this machine" if graph.local else network
    if options.backend == ZENOH:
        reach = f"any program that reaches the router {options.zenoh_connect or ''}".rstrip()
    where = f"ROS 2 by {options.backend}, domain {graph.domain}: {reach}"
    if refuses:
        return f"{where}; read only: {refuses}"
    why = denied(lambda: Client(options.socket)) if options.commands else "--no-commands"
    if why:
        return f"{where}; read only: {why}; from ROS only the e-stop is executed"
    return f"{where}; {reach} may move the robot"
