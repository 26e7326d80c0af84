"""`twindctl status`. Standard library only."""

import argparse

from twind.command_line.verb import DONE, FunctionVerb, observer, show
from twind.ctl.status_table import render


def _arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--joints", action="store_true", help="a line for every joint too")


def _run(options: argparse.Namespace) -> int:
    with observer(options) as client:
        answer = client.call("GetStatus", joints=options.joints or None)
    show(options, answer, render(answer["status"], answer.get("joints")))
    return DONE


STATUS = FunctionVerb(
    "see", "Show the state of the daemon and the robot.", _arguments, _run, supports_remote=True
)
