"""The table: every complaint the doctor knows, and every check that looks for them. One list, in order.

The order is that of looking: cheap and causal first (is there a daemon, a port), then what hangs on it.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from twind.doctor import host_checks, host_rows, robot_checks, robot_rows
from twind.doctor.check import Check, DoctorFinding, Severity
from twind.doctor.check_context import CheckContext

CHECK_BROKEN = Check(
    "CHECK_BROKEN",
    "a check of the doctor failed",
    "its subject was not examined",
    "report it with `twindctl doctor --json`; the other checks ran",
    Severity.WARNING,
)


@dataclass(frozen=True, slots=True)
class CheckProbe:
    """One look. `what` is it in a word for the last line ("ports"); `codes`: all that it can find."""

    what: str
    codes: tuple[str, ...]
    look: Callable[[CheckContext], Iterator[DoctorFinding]]


def complaints() -> dict[str, Check]:
    """Every row by its code, in order."""
    rows = (*host_rows.ROWS, *robot_rows.ROWS, CHECK_BROKEN)
    return {row.code: row for row in rows}


def checks() -> tuple[CheckProbe, ...]:
    """Every check in the order of looking: the host's first, the daemon's own faults last."""
    named = (*host_checks.CHECKS, *robot_checks.CHECKS, *host_checks.AFTER)
    return tuple(CheckProbe(what, codes, look) for what, codes, look in named)
