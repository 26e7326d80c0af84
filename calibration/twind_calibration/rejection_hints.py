"""Rejections that several verbs share: commands completed for the present call, unknown joints."""

import argparse
import functools
from collections.abc import Callable, Sequence

from twind.command_line.verb import Rejected
from twind.ctl.hint_options import command_hint
from twind.robot.joint_map import similar_joints

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


def unknown_joint(robot: str, name: str, known: Sequence[str]) -> Rejected:
    """Return the error for a joint that a robot does not have; it names similar ones of `known`."""
    return Rejected(f"{robot} has no joint {name!r}; {similar_joints(name, known)}")
