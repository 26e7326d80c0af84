"""Report of the doctor, as text and as one JSON object."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from twind.doctor.check import Check, Devices, DoctorFinding, Fix, Severity
from twind.doctor.runner import DoctorReport, FixResult

LABEL = {Severity.FAULT: "FAULT", Severity.WARNING: "WARNING", Severity.NOTE: "NOTE"}


def text(
    outcome: DoctorReport,
    complaints: Mapping[str, Check],
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
        lines += [*_finding(found, complaints[found.code], because, fix, outcome.fix, ids), ""]
    if outcome.fix and mended is None:
        lines += ["what `--fix` can do, all of it, after asking:", f"    {outcome.fix}", ""]
    lines += _last(outcome, complaints, mended, verbose=verbose)
    return "\n".join(lines)


def data(
    outcome: DoctorReport, complaints: Mapping[str, Check], mended: Sequence[FixResult] | None
) -> dict[str, Any]:
    """Return the report as one object: about, found, looked, not_looked, mended (null without `--fix`)."""
    return {
        "about": outcome.about,
        "found": [
            {
                "code": found.code,
                "severity": complaints[found.code].severity.value,
                "title": complaints[found.code].title,
                "thing": found.thing,
                "measured": found.measured,
                "expected": found.expected or None,
                "why": complaints[found.code].why,
                "remedy": found.advice or complaints[found.code].remedy,
                "caution": complaints[found.code].caution or None,
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
    outcome: DoctorReport, complaints: Mapping[str, Check], mended: Sequence[FixResult] | None
) -> int:
    """Count the findings, without notes and without those that were fixed."""
    gone = {id(each.found) for each in mended or () if not each.there and not each.error}
    return sum(
        complaints[found.code].severity is not Severity.NOTE and id(found) not in gone
        for found in outcome.found
    )


def _unseen(outcome: DoctorReport) -> list[tuple[str, str]]:
    """List the skipped checks with reasons; inapplicable checks only where there are no others."""
    return outcome.unseen or ([] if outcome.looked else outcome.absent)


def _about(about: Mapping[str, Any]) -> str:
    """Return the subject of the report in one line: robot, ports, daemon."""
    ports = ", ".join(f"{bus} on {port or 'no port'}" for bus, port in about["ports"].items())
    robot = f"robot {about['robot'] or 'unknown'}" + (f", {ports}" if ports else "")
    daemon = about["daemon"]
    if daemon is None:
        return f"{robot}; no daemon was asked"
    told = ", ".join(f"{key} {daemon[key]}" for key in ("version", "mode", "state") if key in daemon)
    return f"{robot}; daemon at {daemon['socket']}" + (f": {told}" if told else "")


def _finding(
    found: DoctorFinding,
    row: Check,
    because: str | None,
    fix: FixResult | None,
    by_fix: str,
    ids: Mapping[str, Sequence[int]],
) -> list[str]:
    title = f"{LABEL[row.severity]}  {row.code}: {row.title}"
    body = [
        f"{_short(found.thing, ids)}: {found.measured}"
        + (f"; should be {found.expected}" if found.expected else "")
    ]
    body.append(f"why it matters: {row.why}")
    if because is not None:
        body.append(f"probably because of {because}, above")
    if row.caution:
        body.append(f"first: {row.caution}")
    command = "" if found.fix is not None and found.command == by_fix else found.command  # told once, below
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
    complaints: Mapping[str, Check],
    mended: Sequence[FixResult] | None,
    *,
    verbose: bool,
) -> list[str]:
    count = count_problems(outcome, complaints, mended)
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
