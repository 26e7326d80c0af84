"""`twindctl monitor` and `watch`: what the daemon says, as it says it. Standard library only."""

import argparse
import json
import shutil
import sys
from collections.abc import Mapping
from typing import Any

from twind.ctl.table import render
from twind.ctl.verb import DONE, Plain, observer

_HOME, _REST = "\x1b[H", "\x1b[J"  # to the upper left corner; forget what is below
_LINE = "\x1b[K\n"  # forget the rest of the line
_ENTER, _LEAVE = "\x1b[?1049h\x1b[2J", "\x1b[?1049l"  # a screen of its own, and back to what was there


def _arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--rate", type=float, default=5.0, metavar="HZ", help="pictures a second (default 5)")
    parser.add_argument("--count", type=int, metavar="N", help="end after N pictures")
    parser.add_argument("--topics", default="state", help="with --json: topics, by commas (default state)")


def _run(options: argparse.Namespace) -> int:
    with observer(options) as client:
        if options.json:
            topics = options.topics.split(",")
            for shown, news in enumerate(client.stream("Monitor", topics=topics, rate=options.rate), 1):
                print(json.dumps(news, ensure_ascii=False), flush=True)
                if shown == options.count:
                    break
            return DONE
        return table(client.stream("Monitor", topics=["status", "state"], rate=options.rate), options.count)


def table(news: Any, count: int | None) -> int:
    """Pictures of the status that came last with each state, `count` of them or without end."""
    live = sys.stdout.isatty()
    if live:
        sys.stdout.write(_ENTER)
    status, shown = None, 0
    try:
        for message in news:
            if message["topic"] == "status":
                status = message["status"]
                continue
            if status is None:
                continue
            text = render(status, message["joints"])
            sys.stdout.write(_picture(text) if live else text + "\n\n")
            sys.stdout.flush()
            shown += 1
            if shown == count:
                break
    finally:
        if live:
            sys.stdout.write(_LEAVE)
            sys.stdout.flush()
    return DONE


def _picture(text: str) -> str:
    """As much as the terminal has room for, drawn over what was there."""
    columns, rows = shutil.get_terminal_size()
    lines = [line[:columns] for line in text.split("\n")]
    if len(lines) > rows - 1:
        hidden = len(lines) - rows + 2
        lines = [*lines[: rows - 2], f"... {hidden} more lines: make the terminal taller"[:columns]]
    return _HOME + _LINE.join(lines) + _REST


def _watch_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("topic", nargs="?", default="events", choices=["events", "verdicts"])
    parser.add_argument("--count", type=int, metavar="N", help="end after N")


def _watch(options: argparse.Namespace) -> int:
    with observer(options) as client:
        for shown, news in enumerate(client.stream("Monitor", topics=[options.topic]), 1):
            print(json.dumps(news, ensure_ascii=False) if options.json else _line(news), flush=True)
            if shown == options.count:
                break
    return DONE


def _line(news: Mapping[str, Any]) -> str:
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


MONITOR = Plain(_arguments, _run)
WATCH = Plain(_watch_arguments, _watch)
