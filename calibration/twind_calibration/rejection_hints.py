"""Completion of the commands that a rejection names, for the daemon and robot of the present call."""

import argparse
import functools
from collections.abc import Callable

from twind.command_line.verb import Rejected
from twind.ctl.command_hint import command_hint

Command = Callable[[argparse.Namespace], int]


def with_hints(command: Command) -> Command:
    """Wrap a command: the commands in the text of its Rejected carry the options of this call."""

    @functools.wraps(command)
    def run(options: argparse.Namespace) -> int:
        try:
            return command(options)
        except Rejected as error:
            raise Rejected(command_hint(options).prose(str(error))) from error

    return run
