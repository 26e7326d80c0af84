"""Writer of the reference page of the commands: `python -m twind.manual.write_cli_page docs/cli.md`."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from twind.command_line.verb import EXIT_CODES
from twind.ctl.verb_catalog import grouped_verbs, summary
from twind.manual.argument_parsers import HELP, arguments, option_names, programs, subcommands

START = """\
# Commands

`twindctl`, by group, and the other programs. `twindctl VERB --help` and the manual
pages, which `make install` writes, explain the arguments.
`python -m twind.manual.write_cli_page docs/cli.md` writes this page."""


def cli_page() -> str:
    """The page: a table per group of verbs, the common options, the exit codes, the other programs."""
    parsers = {program.name: program.parser for program in programs()}
    control = parsers.pop("twindctl")
    verbs = subcommands(control)
    common = option_names(control)
    shared = _names(control, HELP | {"--version"})
    blocks = [START, f"The help of a verb lists which of {shared} it takes, before or after it."]
    for group, members in grouped_verbs().items():
        rows = [(name, _arguments(verbs[name], common), summary(verb)) for name, verb in members.items()]
        blocks.append(f"## {group.capitalize()}\n\n{_table('verb', rows)}")
    codes = "\n".join(f"| {code} | {meaning} |" for code, meaning in EXIT_CODES.items())
    blocks.append(f"## Exit codes of twindctl\n\n| code | meaning |\n|---|---|\n{codes}")
    others = [(name, _arguments(each, HELP), each.description or "") for name, each in parsers.items()]
    blocks.append(f"## Other programs\n\n{_table('program', others)}")
    return "\n\n".join(blocks) + "\n"


def _table(title: str, rows: Sequence[tuple[str, str, str]]) -> str:
    """Name, arguments and task of each row."""
    lines = [f"| {title} | arguments | task |", "|---|---|---|"]
    lines += [f"| `{name}` | {words} | {_cell(task)} |" for name, words, task in rows]
    return "\n".join(lines)


def _arguments(parser: argparse.ArgumentParser, without: frozenset[str]) -> str:
    """Subcommands and arguments of a parser."""
    steps = ", ".join(f"`{step}`" for step in subcommands(parser))
    return ", ".join(part for part in (steps, _names(parser, without)) if part)


def _names(parser: argparse.ArgumentParser, without: frozenset[str]) -> str:
    """Arguments of a parser in code spans; the options without their values."""
    each_name = ((each.names[-1] if each.names else each.name) for each in arguments(parser, without))
    return ", ".join(f"`{_cell(name)}`" for name in each_name)


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def main(words: list[str]) -> int:
    """Write the named page. Exit code 0."""
    Path(words[0]).write_text(cli_page(), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
