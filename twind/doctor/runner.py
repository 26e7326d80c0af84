"""Table of all subjects, and the run of their checks. A check that fails becomes a finding; the others run.

The order of the table is that of the checks: cheap and causal ones first.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from twind.client import ClientError
from twind.command_line.verb import Rejected
from twind.doctor import (
    adapter,
    can_links,
    daemon,
    host,
    ports,
    robot_files,
    service,
)
from twind.doctor.check import (
    Check,
    CheckNotApplicable,
    Devices,
    DoctorFinding,
    Severity,
    severity_of,
)
from twind.doctor.check_context import CheckContext, Inspection
from twind.doctor.family_doctor import family_subjects
from twind.exceptions import OperationFailed
from twind_drivers.bus import PortError

CHECK_BROKEN = Check(
    "CHECK_BROKEN",
    "a check of the doctor failed",
    "its subject was not examined",
    "report it with `twindctl doctor --json`",
    Severity.WARNING,
)
SEVERITIES = tuple(Severity)  # the worst first
BEFORE_DEVICES = (robot_files, service, daemon, ports, adapter, can_links)


@dataclass
class DoctorReport:
    """Result of one run."""

    about: dict[str, Any] = field(default_factory=dict)  # `CheckContext.about`
    found: list[DoctorFinding] = field(default_factory=list)  # in the order of the report
    because: dict[int, str] = field(default_factory=dict)  # place in `found` -> code of the probable cause
    looked: list[str] = field(default_factory=list)  # subjects that were inspected
    unseen: list[tuple[str, str]] = field(default_factory=list)  # subject that could not be, and reason
    absent: list[tuple[str, str]] = field(default_factory=list)  # subject that does not exist, and reason
    fix: str = ""  # the command that does what `--fix` can do; "": nothing


@dataclass(frozen=True)
class FixResult:
    """Result of one fix. With an empty `error` and not `there`, a second inspection confirmed it."""

    found: DoctorFinding
    error: str  # why it failed or could not be confirmed
    there: bool  # one of its devices at least still has the finding


def table() -> dict[str, Check]:
    """Return every row by its code, in order."""
    rows = [row for subject in (*BEFORE_DEVICES, *family_subjects(), host) for row in subject.ROWS]
    return {row.code: row for row in (*rows, CHECK_BROKEN)}


def all_checks() -> tuple[Inspection, ...]:
    """Return every check in order.

    Faults of the daemon follow the checks that find their causes; the host comes last in the report.
    """
    before = [check for subject in (*BEFORE_DEVICES, *family_subjects()) for check in subject.CHECKS]
    return (*before, *daemon.FAULT_CHECKS, *host.CHECKS)


def run(context: CheckContext, checks: Iterable[Inspection], rows: Mapping[str, Check]) -> DoctorReport:
    """Run each check once. Findings are sorted by severity, and follow the finding that explains them."""
    outcome = DoctorReport(context.about())
    for check in checks:
        _run_one(context, check, outcome)
    outcome.found, outcome.because = _order_findings(outcome.found, rows)
    return outcome


def select_checks(checks: Sequence[Inspection], only: Sequence[str]) -> list[Inspection]:
    """Return the checks that can find one of these codes; without codes all of them."""
    return [check for check in checks if not only or set(check.codes) & set(only)]


def mend(
    outcome: DoctorReport,
    again: Callable[[], CheckContext],
    checks: Sequence[Inspection],
    rows: Mapping[str, Check],
) -> list[FixResult]:
    """Do every fix, then inspect the changed subjects again with a new context."""
    tried = [(found, _try_fix(found)) for found in outcome.found if found.fix is not None]
    if not tried:
        return []
    context = again()
    try:
        after = run(context, select_checks(checks, [found.code for found, _ in tried]), rows)
    finally:
        context.close()
    left = {key for found in after.found for key in _keys(found)}
    unseen = _newly_unseen(outcome, after, checks)
    return [
        FixResult(found, error or unseen.get(found.code, ""), not left.isdisjoint(_keys(found)))
        for found, error in tried
    ]


def _try_fix(found: DoctorFinding) -> str:
    """Do the fix of a finding. Return the reason of its failure; "": it was done."""
    assert found.fix is not None
    try:
        found.fix.do()
    except (OSError, ClientError, PortError, Rejected, OperationFailed) as error:
        return str(error) or type(error).__name__
    return ""


def _keys(found: DoctorFinding) -> set[tuple[str, str, str]]:
    """Identify a finding after a second inspection: code, one device each, and what should be."""
    thing = found.thing
    names = [Devices(thing.bus, [each]) for each in thing.members] if isinstance(thing, Devices) else [thing]
    return {(found.code, str(name), found.expected) for name in names}


def _newly_unseen(before: DoctorReport, after: DoctorReport, checks: Sequence[Inspection]) -> dict[str, str]:
    """Return, by code, why a second inspection failed where the first one succeeded."""
    reasons = {what: why for what, why in after.unseen if (what, why) not in before.unseen}
    for found in after.found:
        if found.code == CHECK_BROKEN.code:
            reasons[found.thing] = found.measured
    seen = {*after.looked, *(what for what, _ in after.unseen)}
    text = "it was done, but could not be looked at again: {}"
    return {
        code: text.format(reasons.get(check.what, "it is not there any more"))
        for check in checks
        if check.what in reasons or check.what not in seen
        for code in check.codes
    }


def _run_one(context: CheckContext, check: Inspection, outcome: DoctorReport) -> None:
    try:
        for found in check.look(context):  # one by one: findings before a failure count
            outcome.found.append(found)
    except CheckNotApplicable as error:
        outcome.absent.append((check.what, str(error)))
        return
    except OperationFailed as error:
        if (check.what, str(error)) not in outcome.unseen:  # several checks share a subject
            outcome.unseen.append((check.what, str(error)))
        return
    except Exception as error:  # noqa: BLE001  the other checks must run
        text = f"could not look: {type(error).__name__}: {error}"
        outcome.found.append(DoctorFinding(CHECK_BROKEN.code, check.what, text))
        return
    if check.what not in outcome.looked:
        outcome.looked.append(check.what)


def _order_findings(
    found: Sequence[DoctorFinding], rows: Mapping[str, Check]
) -> tuple[list[DoctorFinding], dict[int, str]]:
    """Sort by severity; a finding that another one explains follows that one."""
    explained: dict[str, str] = {}
    for each in found:
        for code in rows[each.code].explains:
            explained.setdefault(code, each.code)
    by_severity = sorted(found, key=lambda each: SEVERITIES.index(severity_of(each, rows)))
    ordered: list[DoctorFinding] = []
    because: dict[int, str] = {}

    def add(each: DoctorFinding) -> None:
        if any(each is other for other in ordered):
            return
        ordered.append(each)
        for other in by_severity:
            if explained.get(other.code) == each.code and other.code != each.code:
                place = len(ordered)
                add(other)
                if len(ordered) > place:
                    because[place] = each.code

    for each in by_severity:
        if explained.get(each.code) in (None, each.code):
            add(each)
    for each in by_severity:  # two that explain each other
        add(each)
    return ordered, because
