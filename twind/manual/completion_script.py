"""Completion scripts of bash and zsh, made by shtab from a parser. File arguments complete paths."""

import argparse
import re
from pathlib import Path

import shtab

from twind.manual.argument_parsers import each_action

PATH_WORDS = ("FILE", "DIR", "PATH", "RECORDING", "SOCKET", "OUT.mcap", "PNG")  # in names of path arguments
# shtab's own instructions name other places than ours.
SHTAB_USAGE = re.compile(r"^# Usage:\n(?:#.*\n)*", re.MULTILINE)


def completion_script(parser: argparse.ArgumentParser, shell: str) -> str:
    """The script for `shell`, "bash" or "zsh". The parser is not used for parsing afterwards."""
    for action in each_action(parser):
        name = action.metavar if isinstance(action.metavar, str) else action.dest
        if action.type is Path or any(word in name.split("|") for word in PATH_WORDS):
            action.complete = shtab.FILE  # type: ignore[attr-defined]  # the way that shtab documents
    script = shtab.complete(parser, shell) + "\n"
    return SHTAB_USAGE.sub("# `twindctl completion --help` names the places for this file.\n", script)
