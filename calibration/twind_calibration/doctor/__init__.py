"""Find faults of machine, files, daemon, buses and servos, with remedies.

A running daemon is queried; without one the free ports are opened and read. Nothing moves, no torque
changes, and without `--fix` nothing is written to a servo, a file or a setting of this machine. One
exception: a serial port that is opened is set to low latency until its adapter is unplugged.
"""

import argparse
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from twind.command_line.verb import DONE, REFUSED, UsageError, show

if TYPE_CHECKING:
    from twind_calibration.doctor.check import Check
    from twind_calibration.doctor.runner import DoctorReport

group = "set up"

NICE = 10


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the verb; those that `twind` has too mean the same."""
    parser.add_argument("--fix", action="store_true", help="fix what can be fixed safely, then check again")
    parser.add_argument("--yes", action="store_true", help="with --fix: without asking first")
    parser.add_argument("--only", metavar="CODE", nargs="+", default=[], help="check for these codes only")
    parser.add_argument("--verbose", action="store_true", help="print every check")
    parser.add_argument("--config", metavar="FILE", help="settings, as for `twind`")
    parser.add_argument("--robot", metavar="NAME|FILE", help="robot, as for `twind`")
    parser.add_argument("--calibration", metavar="FILE", help="calibration, as for `twind`")
    parser.add_argument("--port", metavar="PORT|BUS=PORT", action="append", default=[], help="as for `twind`")


def run(options: argparse.Namespace) -> int:
    """Exit code 0: nothing wrong (notes alone do not count), 1: something found, or nothing looked at.

    Raises UsageError.
    """
    # MuJoCo, numpy, YAML: seconds that `twindctl --help` need not pay.
    from twind.command_line.progress import ProgressLine
    from twind_calibration.command_hint import command_hint
    from twind_calibration.doctor import check_table, report, runner
    from twind_calibration.doctor.check_context import CheckContext
    from twind_calibration.doctor.context_builder import examine
    from twind_calibration.doctor.finding_commands import add_commands
    from twind_calibration.doctor.host_inspector import HostInspector
    from twind_drivers.clock import MonotonicClock

    def look() -> CheckContext:
        return examine(options, HostInspector(), MonotonicClock())

    known = check_table.complaints()
    checks = check_table.checks()
    asks = options.fix and not options.yes
    if asks and (options.json or not sys.stdin.isatty()):
        raise UsageError("--fix asks before it changes anything; where nobody can answer, say --fix --yes")
    if unknown := sorted(set(options.only) - set(known)):
        raise UsageError(f"--only: no complaint {unknown[0]!r}; known: {', '.join(known)}")
    examined = look()
    try:
        with _gently(examined.daemon is not None), ProgressLine(options, "doctor") as progress:
            chosen = progress.each(runner.select_checks(checks, options.only), lambda check: check.what)
            outcome = runner.run(examined, chosen, known)
        if options.only:
            outcome.found = [each for each in outcome.found if each.code in {*options.only, "CHECK_BROKEN"}]
            outcome.because = {}
        here = command_hint(options, examined.sockets or None)
        outcome.found, outcome.fix = add_commands(
            outcome.found, known, here, options.only, daemon=examined.daemon is not None
        )
    finally:
        examined.close()
    mended = None
    if options.fix and _agreed(outcome, known, asks):
        with _gently(examined.daemon is not None):
            mended = runner.mend(outcome, look, checks, known)
    text = report.text(outcome, known, mended, verbose=options.verbose)
    show(options, report.data(outcome, known, mended), text)
    return DONE if outcome.looked and not report.count_problems(outcome, known, mended) else REFUSED


@contextmanager
def _gently(beside: bool) -> Iterator[None]:
    """Beside a daemon: after everybody else, for who examines a loop must not make it late."""
    before = os.getpriority(os.PRIO_PROCESS, 0)
    if beside:
        os.setpriority(os.PRIO_PROCESS, 0, max(before, NICE))
    try:
        yield
    finally:
        with suppress(PermissionError):  # who is not root stays so, and is about to end
            os.setpriority(os.PRIO_PROCESS, 0, before)


def _agreed(outcome: "DoctorReport", rows: "Mapping[str, Check]", asks: bool) -> bool:
    """Shows what would be done and its cautions, and waits for a yes; without work it is a yes."""
    fixed = [found for found in outcome.found if found.fix is not None]
    todo = [f"{found.thing}: {found.fix.text}" for found in fixed if found.fix is not None]
    todo += dict.fromkeys(f"first: {rows[each.code].caution}" for each in fixed if rows[each.code].caution)
    if not todo or not asks:
        return True
    print("\n".join(["--fix would do:", *(f"    {each}" for each in todo)]))
    print("do all of this? [y/N] ", end="", flush=True)
    return sys.stdin.readline().strip().lower() in ("y", "yes")  # the end of the input is no yes
