"""What was found, made ready to be told: each command can be copied as it stands, and works here and now."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

from twind.ctl.command_hint import CommandHint
from twind.doctor.bus_surveys import MANY
from twind.doctor.check import Check, DoctorFinding

OTHERS = ("PORT_HELD",)  # codes whose commands ask another daemon than this call's
FIX = "twindctl doctor --fix"
ASKS = re.compile(r"^twindctl (register|reboot|disarm|arm|reset|reload)\b", re.MULTILINE)
WRITE = re.compile(r"twindctl register write (?P<bus>\S+) (?P<id>\d+) (?P<what>.*)")
FIRST = "a running daemon does it (mode live, nobody armed): "


def add_commands(
    found: Sequence[DoctorFinding],
    rows: Mapping[str, Check],
    again: CommandHint,
    only: Sequence[str] = (),
    *,
    daemon: bool,
) -> tuple[list[DoctorFinding], str]:
    """The findings with commands for this call, and the command that does what `--fix` can do ("": nothing).

    `only`: the codes that were asked for; none: all. `daemon`: one was asked. Without, what only a daemon can
    do is either done by `--fix`, on the free port, or said to need one.
    """
    fix = again.command(" ".join([FIX, *(["--only"] if only else []), *only]))
    ready = [_ready(each, rows[each.code], again, fix, daemon=daemon) for each in found]
    return ready, fix if any(each.fix is not None for each in found) else ""


def _ready(each: DoctorFinding, row: Check, again: CommandHint, fix: str, *, daemon: bool) -> DoctorFinding:
    if each.code in OTHERS:
        return each
    command = _shortest(each.command)
    advice = each.advice
    if not daemon and ASKS.search(each.command):
        if each.fix is not None:
            return replace(each, command=fix, advice=again.prose(advice))
        advice = FIRST + (advice or row.remedy)
    return replace(each, command=again.command(command), advice=again.prose(advice or _own(row, each)))


def _own(row: Check, each: DoctorFinding) -> str:
    """The row's remedy where the finding has no command; else the command says it."""
    return "" if each.command else row.remedy


def _shortest(command: str) -> str:
    """The same write to more than a few servos of one bus as one line of shell."""
    lines = command.splitlines()
    writes = [WRITE.fullmatch(line) for line in lines]
    if len(lines) <= MANY or len({write and (write["bus"], write["what"]) for write in writes}) != 1:
        return command
    first = writes[0]
    if first is None:
        return command
    ids = " ".join(write["id"] for write in writes if write is not None)
    return f"for id in {ids}; do twindctl register write {first['bus']} $id {first['what']}; done"
