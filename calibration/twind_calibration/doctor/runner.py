"""Runs the checks over what was examined. One that breaks becomes a finding, and the others go on."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from twind.client import ClientError
from twind.command_line.verb import Rejected
from twind_calibration.doctor.check import (
    Check,
    CheckNotApplicable,
    CheckUnavailable,
    Devices,
    DoctorFinding,
    Severity,
)
from twind_calibration.doctor.check_context import CheckContext
from twind_calibration.doctor.check_table import CHECK_BROKEN, CheckProbe
from twind_calibration.doctor.machine_rows import MACHINE
from twind_drivers.bus import PortError

ORDER = {Severity.FAULT: 0, Severity.WARNING: 1, Severity.NOTE: 2}
LAST = frozenset(row.code for row in MACHINE)  # of one severity, after ports, buses and servos


@dataclass
class DoctorReport:
    """What one run found, and what it could not see."""

    about: dict[str, Any] = field(default_factory=dict)  # `CheckContext.about`
    found: list[DoctorFinding] = field(default_factory=list)  # in the order of telling
    because: dict[int, str] = field(
        default_factory=dict
    )  # place in `found` -> code that probably explains it
    looked: list[str] = field(default_factory=list)  # what was looked at, in a word each
    unseen: list[tuple[str, str]] = field(default_factory=list)  # what could not be looked at, and why
    absent: list[tuple[str, str]] = field(default_factory=list)  # what is not there to be looked at, and why
    fix: str = ""  # the command that does what `--fix` can do; "": nothing


@dataclass(frozen=True)
class FixResult:
    """One fix that was tried. `error` empty and not `there`: mended, and seen to be."""

    found: DoctorFinding
    error: str  # why it could not be done, or why nobody could see whether it helped
    there: bool  # it is still found, of one of its things at least


def run(
    examined: CheckContext, checks: Iterable[CheckProbe], complaints: Mapping[str, Check]
) -> DoctorReport:
    """Every check once, in order; what was found sorted: what explains others first, then by severity."""
    outcome = DoctorReport(examined.about())
    for check in checks:
        _run_one(examined, check, outcome)
    outcome.found, outcome.because = _order_findings(outcome.found, complaints)
    return outcome


def select_checks(checks: Sequence[CheckProbe], only: Sequence[str]) -> list[CheckProbe]:
    """The checks that can find one of these codes; all without any."""
    return [check for check in checks if not only or set(check.codes) & set(only)]


def mend(
    outcome: DoctorReport,
    again: Callable[[], CheckContext],
    checks: Sequence[CheckProbe],
    complaints: Mapping[str, Check],
) -> list[FixResult]:
    """Do what can be done, then look again at what was mended, with nothing remembered."""
    tried: list[tuple[DoctorFinding, str]] = []
    for found in outcome.found:
        if found.fix is not None:
            try:
                found.fix.do()
            except (OSError, ClientError, PortError, Rejected, CheckUnavailable) as error:
                tried.append((found, str(error)))
            else:
                tried.append((found, ""))
    if not tried:
        return []
    examined = again()
    try:
        after = run(examined, select_checks(checks, [found.code for found, _ in tried]), complaints)
    finally:
        examined.close()
    left = {(found.code, thing) for found in after.found for thing in _things(found)}
    unseen = _unseen(outcome, after, checks)
    return [
        FixResult(
            found,
            error or unseen.get(found.code, ""),
            any((found.code, thing) in left for thing in _things(found)),
        )
        for found, error in tried
    ]


def _things(found: DoctorFinding) -> list[str]:
    """What a finding is about, one by one: "bus main ids 1 (neck), 7 (l_knee)" are two."""
    thing = found.thing
    return [Devices(thing.bus, [each]) for each in thing.members] if isinstance(thing, Devices) else [thing]


def _unseen(before: DoctorReport, after: DoctorReport, checks: Sequence[CheckProbe]) -> dict[str, str]:
    """By code: why nobody could look again, where somebody could before."""
    reasons = {what: why for what, why in after.unseen if (what, why) not in before.unseen}
    for found in after.found:
        if found.code == CHECK_BROKEN.code:
            reasons[found.thing] = found.measured
    seen = {*after.looked, *(what for what, _ in after.unseen)}
    said = "it was done, but could not be looked at again: {}"
    return {
        code: said.format(reasons.get(check.what, "it is not there any more"))
        for check in checks
        if check.what in reasons or check.what not in seen
        for code in check.codes
    }


def _run_one(examined: CheckContext, check: CheckProbe, outcome: DoctorReport) -> None:
    try:
        for found in check.look(examined):  # one by one: what came before a failure counts
            outcome.found.append(found)
    except CheckNotApplicable as error:
        outcome.absent.append((check.what, str(error)))
        return
    except CheckUnavailable as error:
        if (check.what, str(error)) not in outcome.unseen:  # several checks look at the same thing
            outcome.unseen.append((check.what, str(error)))
        return
    except Exception as error:  # noqa: BLE001  a doctor that stumbles must still tell the rest
        said = f"could not look: {type(error).__name__}: {error}"
        outcome.found.append(DoctorFinding(CHECK_BROKEN.code, check.what, said))
        return
    if check.what not in outcome.looked:
        outcome.looked.append(check.what)


def _order_findings(
    found: Sequence[DoctorFinding], complaints: Mapping[str, Check]
) -> tuple[list[DoctorFinding], dict[int, str]]:
    """Order of telling: by severity, but what may be explained by another finding comes right after that."""
    explained: dict[str, str] = {}
    for each in found:
        for code in complaints[each.code].explains:
            explained.setdefault(code, each.code)
    by_severity = sorted(found, key=lambda each: (ORDER[complaints[each.code].severity], each.code in LAST))
    told: list[DoctorFinding] = []
    because: dict[int, str] = {}

    def tell(each: DoctorFinding) -> None:
        if any(each is other for other in told):
            return
        told.append(each)
        for other in by_severity:
            if explained.get(other.code) == each.code and other.code != each.code:
                place = len(told)
                tell(other)
                if len(told) > place:
                    because[place] = each.code

    for each in by_severity:
        if explained.get(each.code) in (None, each.code):
            tell(each)
    for each in by_severity:  # two that explain each other
        tell(each)
    return told, because
