"""`twindctl monitor` and `twindctl watch`: streams of Monitor. Pictures need rich, text and JSON nothing."""

import argparse
import json
import signal
import sys
from collections.abc import Mapping
from math import isfinite
from types import FrameType
from typing import Any

from twind.client.monitor_stream import monitor_messages
from twind.command_line.verb import DONE, FunctionVerb, UsageError, harmless, observer

TEXT = """\
Show live data of the whole robot; with --json, stream them.

Joints, buses, loop, latency of each hop, lease, faults with their remedies, refusals. On a terminal q ends,
space freezes, Tab turns pages, up and down move the joints. In a pipe, pictures are printed one after the
other. If the daemon restarts, the verb waits for it."""


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

    news = monitor_messages(lambda: observer(options), options.topics.split(","), options.rate, on_disconnect)
    for shown, message in enumerate(news, 1):
        print(json.dumps(message, ensure_ascii=False), flush=True)
        if shown == options.count:
            break
    return DONE


MONITOR = FunctionVerb("see", TEXT, _arguments, _run, supports_remote=True)


def _watch_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "topic", nargs="?", default="events", choices=["events", "verdicts"], help="default: events"
    )
    parser.add_argument("--count", type=int, metavar="N", help="end after N")


def _watch(options: argparse.Namespace) -> int:
    with observer(options) as client:
        for shown, news in enumerate(client.stream("Monitor", topics=[options.topic]), 1):
            print(
                json.dumps(news, ensure_ascii=False) if options.json else harmless(_news_line(news)),
                flush=True,
            )
            if shown == options.count:
                break
    return DONE


def _news_line(news: Mapping[str, Any]) -> str:
    lost = f"({news['dropped']} lost) " if news["dropped"] else ""
    if news["topic"] == "verdicts":
        verdict = news["verdict"]
        said = [finding["message"] for key in ("refusals", "warnings", "changes") for finding in verdict[key]]
        return (
            f"{news['time']:.3f} {lost}{'refused' if verdict['refusals'] else 'accepted'} {'; '.join(said)}"
        )
    event = news["event"]
    found = "".join(f"; {finding['message']}" for finding in event["findings"])
    return f"{event['time']:.3f} {lost}{event['level']:<7} {event['code']}: {event['message']}{found}"


WATCH = FunctionVerb("see", "Print events as they happen.", _watch_arguments, _watch, supports_remote=True)
