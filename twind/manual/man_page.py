"""Manual pages in roff, made from a parser: name, synopsis, options, verbs, exit codes."""

import argparse
import re
from collections.abc import Iterator, Mapping

from twind.command_line.verb import EXIT_CODES
from twind.ctl.verb_catalog import grouped_verbs
from twind.manual.argument_parsers import (
    HELP,
    ProgramManual,
    arguments,
    option_names,
    programs,
    subcommands,
    version,
)

DAEMON_EXIT_CODES = {
    0: "ended as requested; with --failsafe: torque is off everywhere",
    1: "failed; with --failsafe: torque is left on, or its state is unknown",
    2: "wrong usage or files",
    3: "with --failsafe: another process has a port",
}
VIRTUAL_EXIT_CODES = {0: "ended as requested", 2: "wrong usage or files"}
CODES: Mapping[str, Mapping[int, str]] = {
    "twind": DAEMON_EXIT_CODES,
    "twindctl": EXIT_CODES,
    "twind-virtual": VIRTUAL_EXIT_CODES,
}


def man_page(program: ProgramManual) -> str:
    """The page of one program, with each verb below its group."""
    parser = program.parser
    text = (parser.description or "").strip()
    lines = [f'.TH {_roff(program.name.upper())} {program.section} "" "{version()}" "twind manual"']
    lines += [".SH NAME", f"{_roff(program.name)} \\- {_roff(text.rstrip('.'))}"]
    verbs = subcommands(parser)
    lines += [
        ".SH SYNOPSIS",
        rf"\fB{_roff(program.name)}\fR [\fIoptions\fR]" + (r" \fIverb\fR ..." if verbs else ""),
    ]
    lines += [".SH OPTIONS", *_options(parser)]
    if verbs:
        for group, members in grouped_verbs().items():
            lines += [f".SH VERBS: {_roff(group.upper())}"]
            for name in members:
                lines += _verb(name, verbs[name], option_names(parser))
    lines += [".SH EXIT STATUS"]
    for code, meaning in CODES[program.name].items():
        lines += [".TP", f"\\fB{code}\\fR", _roff(meaning)]
    others = [other for other in programs() if other.name != program.name]
    lines += [".SH SEE ALSO", ", ".join(rf"\fB{_roff(each.name)}\fR({each.section})" for each in others)]
    return "\n".join(lines) + "\n"


def _verb(name: str, parser: argparse.ArgumentParser, common: frozenset[str]) -> Iterator[str]:
    """A verb or a subcommand of one: its help, its arguments, its own subcommands."""
    yield f".SS {_roff(name)}"
    for place, paragraph in enumerate(_paragraphs(parser.description)):
        if place:
            yield ".PP"
        yield _roff(paragraph)
    yield from _options(parser, common)
    for step, child in subcommands(parser).items():
        yield from _verb(f"{name} {step}", child, common)


def _options(parser: argparse.ArgumentParser, without: frozenset[str] = HELP) -> Iterator[str]:
    for each in arguments(parser, without):
        yield ".TP"
        yield rf"\fB{_roff(each.name)}\fR"
        yield _roff(each.help) or r"\&"


def _paragraphs(text: str | None) -> list[str]:
    return [" ".join(part.split()) for part in re.split(r"\n\s*\n", (text or "").strip()) if part]


def _roff(text: str) -> str:
    """Text without what roff would take for a request, an escape or a hyphen to break at."""
    escaped = text.replace("\\", r"\e").replace("-", r"\-")
    return rf"\&{escaped}" if escaped.startswith((".", "'")) else escaped
