"""Connect the robot to remote machines over Zenoh.

A client of observe.sock, and of control.sock where it may open it; otherwise it only reads. Every client
with its key space (`twind/ROBOT/...`) receives the state and may stop the robot. A goal is a trajectory
with a name, a deadline and a lease that lapses within a second, and passes the gate as any other. Arming,
modes and registers are not offered remotely. `twindctl --remote ROBOT` and `twindctl fleet` are the other
end.
"""

from __future__ import annotations

import argparse
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from math import isfinite
from typing import Any

from twind.bridge.bridge_log import BridgeLog, print_line
from twind.bridge.zenoh import zenoh_session
from twind.bridge.zenoh.zenoh_keys import chunk
from twind.bridge.zenoh.zenoh_session import NetworkConfig
from twind.command_line.stop_signals import catch_stop_signals
from twind.command_line.verb import DONE, Rejected, UsageError, show

group = "connect"

LOOK = 0.2  # s between two checks for an end
AGAIN = 1.0  # s until it continues under another name


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `twindctl uplink`."""
    parser.add_argument(
        "--name",
        metavar="NAME",
        help="what the robot is called there (default: the individual's, or its own)",
    )
    zenoh_session.add_options(parser)
    parser.add_argument("--seconds", type=float, metavar="S", help="stop by itself")


def run(options: argparse.Namespace) -> int:
    """Run until a stop signal: 0. The name is taken, or the network cannot be joined as configured: 1."""
    try:
        if options.name is not None:
            chunk("--name", options.name)
    except ValueError as error:
        raise UsageError(str(error)) from None
    if options.seconds is not None and not (isfinite(options.seconds) and options.seconds > 0.0):
        raise UsageError(f"--seconds {options.seconds:g}: must be above 0")
    place = zenoh_session.place(options, os.environ)
    for each in zenoh_session.readable(place):
        print_line(f"{each}: every host on the path can read and command; use tls/ with certificates")
    log = BridgeLog()
    with catch_stop_signals() as stop, _for(options.seconds, stop), log.writing():
        tally: dict[str, object] = {}
        while not stop.is_set():
            tally = _joined(options, place, stop, log) or tally
            stop.wait(AGAIN)
    show(options, tally, _text(tally))
    return DONE


def _joined(
    options: argparse.Namespace, place: NetworkConfig, stop: threading.Event, log: BridgeLog
) -> dict[str, object] | None:
    """Run under one name to its end; return the tally of calls, None for none.

    Raises Rejected: name taken.
    """
    session = zenoh_session.open_session(place, stop, log)
    if session is None:
        return None
    from twind.bridge.uplink.robot_uplink import RobotUplink, awaited_name

    with session:
        robot = options.name or awaited_name(options, stop, log)
        if not robot:
            return None
        uplink = RobotUplink(options, session, robot, log)
        try:
            uplink.start()
            log(f"{robot} is up at {place}")
            while not (stop.wait(LOOK) or uplink.is_over(time.monotonic())):
                pass
        finally:
            uplink.close()
    if uplink.rival:
        raise Rejected(uplink.rival)
    return {"robot": robot, "lanes": uplink.tally()}


@contextmanager
def _for(seconds: float | None, stop: threading.Event) -> Iterator[None]:
    """Set `stop` after `seconds`; None: never."""
    timer = None if seconds is None else threading.Timer(seconds, stop.set)
    if timer is not None:
        timer.start()
    try:
        yield
    finally:
        if timer is not None:
            timer.cancel()


def _text(tally: dict[str, Any]) -> str:
    """Format the numbers of answered and refused calls."""
    queues = tally.get("lanes", {})
    counts = [f"{name} {each['answered']}" for name, each in queues.items() if each["answered"]]
    full = sum(each["refused"] for each in queues.values())
    return f"answered: {', '.join(counts) or 'nothing'}" + (f"; no room for {full}" if full else "")
