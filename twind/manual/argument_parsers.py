"""Content of argument parsers: names and help of their arguments, and their subcommands.

`argparse` has no public way to list the arguments of a parser. This module alone reads its private lists.
"""

import argparse
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass

from twind import cli
from twind.ctl import ctl_main
from twind.version import __version__
from twind.virtual import virtual_main

HELP = frozenset({"-h", "--help"})


@dataclass(frozen=True, slots=True)
class ArgumentText:
    """One argument. `name`: as it is written, `--rate HZ` or `FILE`; `names`: the option strings."""

    name: str
    help: str
    names: tuple[str, ...]
    required: bool


@dataclass(frozen=True, slots=True)
class ProgramManual:
    """A program with a manual page: its parser and the section of the page."""

    parser: argparse.ArgumentParser
    section: int

    @property
    def name(self) -> str:
        """The command, also the name of the page."""
        return self.parser.prog


def programs() -> tuple[ProgramManual, ...]:
    """All programs of twind. Imports every verb."""
    return (
        ProgramManual(cli.parser(), 8),
        ProgramManual(ctl_main.full_parser(), 1),
        ProgramManual(virtual_main.parser(), 1),
    )


def arguments(parser: argparse.ArgumentParser, without: Collection[str] = HELP) -> list[ArgumentText]:
    """Arguments of a parser, its subcommands left out. `without`: option strings that are left out too."""
    return [
        ArgumentText(_name(action), _help(action, parser), tuple(action.option_strings), action.required)
        for action in parser._actions
        if not isinstance(action, argparse._SubParsersAction)
        and not set(action.option_strings) & set(without)
        and action.help is not argparse.SUPPRESS
    ]


def option_names(parser: argparse.ArgumentParser) -> frozenset[str]:
    """Option strings of a parser, `--help` among them."""
    return frozenset(name for action in parser._actions for name in action.option_strings)


def subcommands(parser: argparse.ArgumentParser) -> Mapping[str, argparse.ArgumentParser]:
    """Parsers of the subcommands by name; empty: there are none."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            return dict(action.choices)
    return {}


def each_action(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """Arguments of a parser and of all its subcommands."""
    yield from parser._actions
    for child in subcommands(parser).values():
        yield from each_action(child)


def _name(action: argparse.Action) -> str:
    """As it is written on a command line; the shorter option string is left out."""
    value = _value(action)
    return " ".join(part for part in (*action.option_strings[-1:], value) if part)


def _value(action: argparse.Action) -> str:
    if action.nargs == 0:
        return ""
    if action.choices is not None and action.metavar is None:
        value = "{" + ",".join(str(choice) for choice in action.choices) + "}"
    elif isinstance(action.metavar, tuple):
        value = " ".join(action.metavar)
    else:
        value = action.metavar or action.dest.upper()
    return f"{value} ..." if action.nargs in ("*", "+") else value


def _help(action: argparse.Action, parser: argparse.ArgumentParser) -> str:
    values = {key: getattr(value, "__name__", value) for key, value in vars(action).items()}
    return (action.help or "") % (values | {"prog": parser.prog})


def version() -> str:
    """Name and version of the programs, for the foot of a page."""
    return f"twind {__version__}"
