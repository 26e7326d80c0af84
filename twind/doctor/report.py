"""Report of the doctor, as text and as one JSON object. Commands are completed for a copy to the shell."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from twind.ctl.hint_options import HintOptions
from twind.doctor.check import MANY, Check, Devices, DoctorFinding, Fix, Severity, caution_of, severity_of
from twind.doctor.runner import DoctorReport, FixResult

OTHERS = ("PORT_HELD",)  # codes whose commands ask another daemon than that of this call
FIX = "twindctl doctor --fix"
ASKS = re.compile(r"^twindctl (register|reboot|disarm|arm|reset|reload)\b", re.MULTILINE)
WRITE = re.compile(r"twindctl register write (?P<bus>\S+) (?P<id>\d+) (?P<what>.*)")
FIRST = "a running daemon does it (mode live, disarmed): "


def add_commands(
    found: Sequence[DoctorFinding],
    rows: Mapping[str, Check],
    again: HintOptions,
    only: Sequence[str] = (),
    *,
    daemon: bool,
) -> tuple[list[DoctorFinding], str]:
    """Return the findings with commands for this call, and the command of `--fix` ("": it can do nothing).

    `only`: the codes of `--only`. `daemon`: whether one was asked. Without a daemon, `--fix` writes registers
    on the free port; other commands get the advice to start a daemon first.
    """
    fix = again.command(" ".join([FIX, *(["--only"] if only else []), *only]))
    ready = [_complete(each, rows[each.code], again, fix, daemon=daemon) for each in found]
    return ready, fix if any(each.fix is not None for each in found) else ""


def _complete(
    each: DoctorFinding, row: Check, again: HintOptions, fix: str, *, daemon: bool
) -> DoctorFinding:
    if each.code in OTHERS:
        return each
    command = _shorten(each.command)
    advice = each.advice
    if not daemon and ASKS.search(each.command):
        if each.fix is not None:
            return replace(each, command=fix, advice=again.prose(advice))
        advice = FIRST + (advice or row.remedy)
    advice = advice or ("" if each.command else row.remedy)
    return replace(each, command=again.command(command), advice=again.prose(advice))


def _shorten(command: str) -> str:
    """Join equal writes to more than `MANY` servos of one bus into one shell loop."""
    lines = command.splitlines()
    writes = [found for line in lines if (found := WRITE.fullmatch(line))]
    same = len(writes) == len(lines) and len({(each["bus"], each["what"]) for each in writes}) == 1
    if len(lines) <= MANY or not same:
        return command
    ids = " ".join(each["id"] for each in writes)
    return f"for id in {ids}; do twindctl register write {writes[0]['bus']} $id {writes[0]['what']}; done"


def text(
    outcome: DoctorReport,
    rows: Mapping[str, Check],
    mended: Sequence[FixResult] | None,
    *,
    verbose: bool = False,
) -> str:
    """Return the text report. `mended`: result of `--fix`; None without it. `verbose`: lists all checks."""
    lines = [_about(outcome.about), ""] if outcome.about else []
    ids = outcome.about.get("ids", {})
    fixes = {id(each.found): each for each in mended or ()}
    for place, found in enumerate(outcome.found):
        because = outcome.because.get(place)
        fix = fixes.get(id(found))
        lines += [*_finding(found, rows[found.code], because, fix, outcome.fix, ids), ""]
    if outcome.fix and mended is None:
        lines += ["what `--fix` can do, all of it, after asking:", f"    {outcome.fix}", ""]
    lines += _last(outcome, rows, mended, verbose=verbose)
    return "\n".join(lines)


def data(
    outcome: DoctorReport, rows: Mapping[str, Check], mended: Sequence[FixResult] | None
) -> dict[str, Any]:
    """Return the report as one object: about, found, looked, not_looked, mended (null without `--fix`)."""
    return {
        "about": outcome.about,
        "found": [
            {
                "code": found.code,
                "severity": severity_of(found, rows).value,
                "title": rows[found.code].title,
                "thing": found.thing,
                "measured": found.measured,
                "expected": found.expected or None,
                "why": rows[found.code].why,
                "remedy": found.advice or rows[found.code].remedy,
                "caution": caution_of(found, rows) or None,
                "command": found.command or None,
                "fix": None if found.fix is None else str(found.fix),
                "because_of": outcome.because.get(place),
            }
            for place, found in enumerate(outcome.found)
        ],
        "looked": outcome.looked,
        "not_looked": [{"what": what, "why": why} for what, why in _unseen(outcome)],
        "mended": None
        if mended is None
        else [
            {
                "code": each.found.code,
                "thing": each.found.thing,
                "done": str(each.found.fix or ""),
                "error": each.error or None,
                "still_there": each.there,
            }
            for each in mended
        ],
    }


def count_problems(
    outcome: DoctorReport, rows: Mapping[str, Check], mended: Sequence[FixResult] | None
) -> int:
    """Count the findings, without notes and without those that were fixed."""
    gone = {id(each.found) for each in mended or () if not each.there and not each.error}
    return sum(
        severity_of(found, rows) is not Severity.NOTE and id(found) not in gone for found in outcome.found
    )


def _unseen(outcome: DoctorReport) -> list[tuple[str, str]]:
    """List the skipped checks with reasons; inapplicable checks only where there are no others."""
    return outcome.unseen or ([] if outcome.looked else outcome.absent)


def _about(about: Mapping[str, Any]) -> str:
    """Return the subject of the report in one line: robot, ports, daemon."""
    ports = ", ".join(f"{bus} on {port or 'no port'}" for bus, port in about["ports"].items())
    robot = f"robot {about['robot'] or 'unknown'}"
    if about["robot_by_default"]:
        robot += " (only the default: name yours with --robot NAME|FILE or `robot:` in the settings)"
    robot += f", {ports}" if ports else ""
    daemon = about["daemon"]
    if daemon is None:
        return f"{robot}; no daemon was asked"
    state = ", ".join(f"{key} {daemon[key]}" for key in ("version", "mode", "state") if key in daemon)
    return f"{robot}; daemon at {daemon['socket']}" + (f": {state}" if state else "")


def _finding(
    found: DoctorFinding,
    row: Check,
    because: str | None,
    fix: FixResult | None,
    by_fix: str,
    ids: Mapping[str, Sequence[int]],
) -> list[str]:
    title = f"{(found.severity or row.severity).name}  {row.code}: {row.title}"
    body = [
        f"{_short(found.thing, ids)}: {found.measured}"
        + (f"; should be {found.expected}" if found.expected else "")
    ]
    body.append(f"why it matters: {row.why}")
    if because is not None:
        body.append(f"probably because of {because}, above")
    if caution := caution_of(found, {found.code: row}):
        body.append(f"first: {caution}")
    command = (
        "" if found.fix is not None and found.command == by_fix else found.command
    )  # it follows below, once
    if found.advice or not found.command:
        body.append(f"do: {found.advice or row.remedy}")
    if command:
        body += [f"    {line}" for line in command.splitlines()]
    if fix is not None:
        body.append(_fixed(fix, ids))
    elif found.fix is not None:
        body.append(f"`--fix` does it: {_does(found.fix, ids)}")
    return [title, *(f"    {line}" for each in body for line in each.splitlines())]


def _fixed(fix: FixResult, ids: Mapping[str, Sequence[int]]) -> str:
    what = _does(fix.found.fix, ids) if fix.found.fix is not None else ""
    if fix.error:
        return f"not mended: {what}: {fix.error}"
    return f"done, but it is still there: {what}" if fix.there else f"mended: {what}"


def _does(fix: Fix, ids: Mapping[str, Sequence[int]]) -> str:
    return str(replace(fix, thing=_short(fix.thing, ids)))


def _short(thing: str, ids: Mapping[str, Sequence[int]]) -> str:
    """Name all servos of a bus by first and last id, since a full list repeats the whole robot."""
    if not isinstance(thing, Devices) or len(thing.ids) < 2:
        return thing
    own = sorted(thing.ids)
    if own != sorted(ids.get(thing.bus, ())):
        return thing
    return f"bus {thing.bus} ids {own[0]}-{own[-1]} (all {len(own)})"


def _last(
    outcome: DoctorReport,
    rows: Mapping[str, Check],
    mended: Sequence[FixResult] | None,
    *,
    verbose: bool,
) -> list[str]:
    count = count_problems(outcome, rows, mended)
    verdict = (
        "nothing wrong" if count == 0 else "1 thing is wrong" if count == 1 else f"{count} things are wrong"
    )
    seen = len(outcome.looked)
    if not seen and not count:
        verdict = "nothing is known"
    line = f"{verdict}; looked at {seen} thing{'s' * (seen != 1)}"
    if verbose:
        line = f"{verdict}; looked at: {', '.join(outcome.looked) or 'nothing'}"
    if unseen := _unseen(outcome):
        reasons: dict[str, list[str]] = {}
        for what, why in unseen:
            reasons.setdefault(why, []).append(what)
        grouped = [f"{', '.join(dict.fromkeys(whats))} ({why})" for why, whats in reasons.items()]
        line += "; could not look at: " + "; ".join(grouped)
    return [line]
