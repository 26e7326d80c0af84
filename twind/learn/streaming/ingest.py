"""Receive the messages of `twindctl stream`: an endpoint for tests.

Keeps each message once, as lines of JSON and images. It has no password and no encryption, and listens to
this machine alone unless --listen names another address. --fail makes it misbehave at random, to show that
nothing is lost.
"""

import argparse
import json
import sys
from pathlib import Path

from twind.command_line.progress import ProgressLine
from twind.command_line.stop_signals import catch_stop_signals
from twind.command_line.verb import DONE, Rejected, UsageError, show

group = "connect"

LISTEN = "127.0.0.1:8000"
LOOK = 0.5  # s between two pictures of the counts


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `twindctl ingest`."""
    parser.add_argument(
        "--listen", default=LISTEN, metavar="ADDRESS:PORT", help=f"default {LISTEN}; port 0: any free"
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("ingest"),
        metavar="DIR",
        help="where messages are kept (default: ingest)",
    )
    parser.add_argument(
        "--fail",
        type=float,
        default=0.0,
        metavar="SHARE",
        help="of the messages: refused, cut off, not answered, or answered with rubbish",
    )
    parser.add_argument(
        "--refuse",
        type=float,
        default=0.0,
        metavar="SHARE",
        help="of the messages: 422, so that they become dead letters",
    )
    parser.add_argument("--slow", type=float, default=0.0, metavar="S", help="before each answer")
    parser.add_argument("--seed", type=int, default=0, help="of what fails")


def run(options: argparse.Namespace) -> int:
    """Until told to stop; 0."""
    from twind.learn.streaming.ingest_server import IngestFaults, IngestServer, IngestStore, address

    if not (0.0 <= options.fail <= 1.0 and 0.0 <= options.refuse <= 1.0 and 0.0 <= options.slow <= 3600.0):
        raise UsageError("--fail and --refuse are shares from 0 to 1, --slow are seconds from 0 to 3600")
    try:
        where = address(options.listen)
    except ValueError as error:
        raise UsageError(f"--listen {options.listen}: {error}") from None
    try:
        store = IngestStore(options.out)
        server = IngestServer(
            where, store, IngestFaults(options.fail, options.refuse, options.slow, options.seed)
        )
    except OSError as error:
        raise Rejected(f"{options.listen}, {options.out}: {error.strerror or error}") from None
    with catch_stop_signals() as stop, store, ProgressLine(options, "ingest") as progress:
        server.start()
        if not options.json:
            print(f"ingest    {server.url} into {options.out}", flush=True)
        else:
            print(json.dumps({"url": server.url, "out": str(options.out)}), flush=True)
        if not where.local:
            print(f"twindctl: whoever reaches {where.host} may write here", file=sys.stderr, flush=True)
        while not stop.wait(LOOK):
            progress.update(store.summary())
        server.stop()
    show(options, store.counts(), store.summary())
    return DONE
