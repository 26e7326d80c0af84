"""List local and remote robots with their state.

Local robots are found by their sockets (all instances, or the one of --socket), remote robots by their
uplinks. A robot that disappears stays in the list as lost. Exit code 3: there is no robot, a named ROBOT is
lost or does not answer, or the named network cannot be joined.
"""

import argparse
import json
import os
import sys
import threading
import time
from collections.abc import Sequence

from twind.bridge.bridge_log import print_line
from twind.bridge.fleet.fleet_monitor import PERIOD, FleetMonitor
from twind.bridge.fleet.fleet_roster import FleetRoster, RobotRecord
from twind.bridge.fleet.fleet_table import rows, to_json
from twind.bridge.zenoh.zenoh_session import VARIABLE, add_options, place
from twind.command_line.stop_signals import catch_stop_signals
from twind.command_line.verb import DONE, NO_DAEMON, UsageError
from twind.ctl.dashboard.terminal_screen import TerminalScreen, is_live

group = "connect"

PATIENCE = 3.0  # s to wait for the answers to a single list
WIDTH = 160  # columns without a terminal; COLUMNS overrides it


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `twindctl fleet`."""
    parser.add_argument("robots", nargs="*", metavar="ROBOT", help="only these robots; an absent one is lost")
    way = parser.add_mutually_exclusive_group()
    way.add_argument("--watch", action="store_true", help="update the list until Ctrl-C or q")
    way.add_argument("--view", action="store_true", help="side by side in a browser, with stop and e-stop")
    parser.add_argument("--count", type=int, metavar="N", help="with --watch: end after N lists")
    parser.add_argument("--port", type=int, metavar="N", help="with --view: of its page")
    parser.add_argument("--open", action="store_true", help="with --view: open a browser")
    add_options(parser)


def run(options: argparse.Namespace) -> int:
    """Print one list, a list each second, or open a page."""
    if options.count is not None and (options.count < 1 or not options.watch):
        raise UsageError(f"--count {options.count}: goes with --watch, and is at least 1")
    if (options.port is not None or options.open) and not options.view:
        raise UsageError("--port and --open go with --view")
    monitor = FleetMonitor(FleetRoster(options.robots), place(options, os.environ), options.socket)
    try:
        if options.view:
            return _view(monitor, options)
        return _watch(monitor, options) if options.watch else _once(monitor, options)
    finally:
        monitor.close()


def _once(monitor: FleetMonitor, options: argparse.Namespace) -> int:
    monitor.once(PATIENCE, print_line)
    robots = monitor.roster.robots()
    network = options.connect or options.listen or options.zenoh_config or os.environ.get(VARIABLE)
    if monitor.trouble and (network or not robots):
        print_line(monitor.trouble)
    _show(robots, options)
    named = [each for each in robots if each.name in options.robots]
    silent = [each for each in named if each.lost or each.odd or each.reported_at is None]
    return NO_DAEMON if not robots or silent or (network and monitor.trouble) else DONE


def _watch(monitor: FleetMonitor, options: argparse.Namespace) -> int:
    with catch_stop_signals() as stop:
        if is_live() and not options.json:
            monitor.begin(lambda _why: None)
            _draw(monitor, options.count, stop)
            return DONE
        monitor.begin(print_line)
        shown = 0
        while shown != options.count and not stop.wait(PERIOD):
            shown += 1
            _show(monitor.roster.robots(), options)
    return DONE


def _draw(monitor: FleetMonitor, count: int | None, stop: threading.Event) -> None:
    """Draw on a terminal, until a key or a signal ends it."""
    from rich.console import Console

    from twind.ctl.dashboard.dashboard_renderer import Palette
    from twind.ctl.dashboard.styled_lines import cut, line

    palette = Palette.for_console(Console(file=sys.stdout))
    pictures = 0
    with TerminalScreen().entered() as screen:
        while not stop.is_set() and pictures != count:
            pictures += 1
            size = screen.size()
            picture = rows(monitor.roster.robots(), time.monotonic(), size[0])
            if monitor.trouble:
                picture += [(), cut(line((monitor.trouble, "warn")), size[0])]
            screen.draw([palette.text(each) for each in picture[: size[1]]], size)
            if "quit" in screen.wait(PERIOD / 2.0):
                return


def _view(monitor: FleetMonitor, options: argparse.Namespace) -> int:
    from twind.observe.view import needed

    needed(options.port)
    from twind.bridge.fleet.viewer_robots import found
    from twind.observe.viewing.fleet import watch

    monitor.begin(print_line)
    return watch(lambda: found(monitor), port=options.port, open_page=options.open, as_json=options.json)


def _show(robots: Sequence[RobotRecord], options: argparse.Namespace) -> None:
    now = time.monotonic()
    if options.json:
        # ASCII: text of robots must not contain control sequences of the terminal.
        print(json.dumps({"robots": [to_json(each, now) for each in robots]}, allow_nan=False), flush=True)
        return
    from rich.console import Console

    from twind.ctl.dashboard.dashboard_renderer import Palette, plain

    if is_live():
        console = Console(file=sys.stdout)
        palette = Palette.for_console(console)
        text = "\n".join(palette.text(each) for each in rows(robots, now, console.width))
    else:
        text = plain(rows(robots, now, int(os.environ.get("COLUMNS") or 0) or WIDTH))
    print((text if robots else "no robots") + ("\n" if options.watch else ""), flush=True)
