"""`twindctl watch`: events or verdicts, a line each, as they come. Standard library only."""

import argparse
import json
from collections.abc import Mapping
from typing import Any

from twind.command_line.verb import DONE, FunctionVerb, harmless, observer


def _arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "topic", nargs="?", default="events", choices=["events", "verdicts"], help="default: events"
    )
    parser.add_argument("--count", type=int, metavar="N", help="end after N")


def _run(options: argparse.Namespace) -> int:
    with observer(options) as client:
        for shown, news in enumerate(client.stream("Monitor", topics=[options.topic]), 1):
            print(json.dumps(news, ensure_ascii=False) if options.json else harmless(_line(news)), flush=True)
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


WATCH = FunctionVerb("see", "Print events as they happen.", _arguments, _run, supports_remote=True)
