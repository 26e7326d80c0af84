"""`twindctl monitor`: a live picture of everything, or NDJSON. Its pictures need rich, its JSON nothing."""

import argparse
import json
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from math import isfinite
from types import FrameType
from typing import Any

from twind.client import Client, ClientError
from twind.command_line.verb import DONE, FunctionVerb, UsageError, harmless, observer

TOPICS = ("status", "state", "latency", "events", "verdicts")  # of a picture
TEXT = """\
Show live data of the whole robot; with --json, stream them.

Joints, buses, loop, latency of each hop, lease, faults with their remedies, refusals. On a terminal q ends,
space freezes, Tab turns pages, up and down move the joints. In a pipe, pictures are printed one after the
other. If the daemon restarts, the verb waits for it."""
AGAIN = 0.3  # s between two tries to reach a daemon that went away


def _arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--rate",
        type=float,
        default=5.0,
        metavar="HZ",
        help="news a second, at most the loop's (default 5); pictures are drawn 15 times a second at most",
    )
    parser.add_argument("--count", type=int, metavar="N", help="end after N pictures, or N lines of JSON")
    parser.add_argument(
        "--topics",
        default="state",
        help="with --json, by commas: state (default), latency, status, raw, events, verdicts, trajectories, "
        "stream",
    )


def _run(options: argparse.Namespace) -> int:
    if not (isfinite(options.rate) and options.rate > 0.0):
        raise UsageError(f"--rate {options.rate:g} must be positive")
    if options.count is not None and options.count < 1:
        raise UsageError(f"--count {options.count} must be positive")
    if options.json:
        return _lines(options)
    from twind.ctl.dashboard.live_dashboard import show  # rich: a tenth of a second that no other verb pays

    before = [signal.signal(number, _on_signal) for number in (signal.SIGTERM, signal.SIGHUP)]
    try:
        return show(lambda: observer(options), options.rate, options.count)
    finally:
        for number, handler in zip((signal.SIGTERM, signal.SIGHUP), before, strict=True):
            signal.signal(number, handler)


def _on_signal(number: int, _frame: FrameType | None) -> None:
    """End by an exception, which gives the terminal back."""
    raise SystemExit(128 + number)


def _lines(options: argparse.Namespace) -> int:
    """NDJSON of the asked topics, as the interface spells them."""

    def on_disconnect(why: str) -> None:
        print(f"twindctl: {harmless(why)}; waiting for the next daemon", file=sys.stderr, flush=True)

    news = steady(lambda: observer(options), options.topics.split(","), options.rate, on_disconnect)
    for shown, message in enumerate(news, 1):
        print(json.dumps(message, ensure_ascii=False), flush=True)
        if shown == options.count:
            break
    return DONE


def steady(
    connect: Callable[[], Client], topics: Sequence[str], rate: float, gone: Callable[[str], None]
) -> Iterator[dict[str, Any]]:
    """Messages of Monitor without end, of one daemon after the other. `gone` receives the reason of each end.

    Blocks. Raises ClientError if the first one cannot be reached or does not answer.
    """
    client = connect()
    answered = False
    while True:
        try:
            with client:
                for message in client.stream("Monitor", topics=list(topics), rate=rate):
                    answered = True
                    yield message
        except ClientError as error:
            if not answered:
                raise
            gone(str(error))
        client = _reconnect(connect)


def _reconnect(connect: Callable[[], Client]) -> Client:
    while True:
        time.sleep(AGAIN)
        try:
            return connect()
        except ClientError:
            continue


def is_live() -> bool:
    """Standard output is a terminal that can be drawn on."""
    return sys.stdout.isatty() and os.environ.get("TERM", "dumb") not in ("dumb", "unknown", "")


MONITOR = FunctionVerb("see", TEXT, _arguments, _run, supports_remote=True)
