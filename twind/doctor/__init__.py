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
    from twind.doctor.check import Check
    from twind.doctor.runner import DoctorReport

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
    """Run the doctor. Exit code 0: nothing wrong (notes do not count); 1: a finding, or nothing inspected.

    Raises UsageError.
    """
    # MuJoCo, numpy, YAML: seconds that `twindctl --help` need not pay.
    from twind.command_line.progress import ProgressLine
    from twind.ctl.hint_options import command_hint
    from twind.doctor import report, runner
    from twind.doctor.check_context import CheckContext, examine
    from twind.doctor.host_inspector import HostInspector
    from twind_drivers.clock import MonotonicClock

    def look() -> CheckContext:
        return examine(options, HostInspector(), MonotonicClock())

    known = runner.table()
    checks = runner.all_checks()
    asks = options.fix and not options.yes
    if asks and (options.json or not sys.stdin.isatty()):
        raise UsageError("--fix asks before it changes anything; without a terminal use --fix --yes")
    if unknown := sorted(set(options.only) - set(known)):
        raise UsageError(f"--only: no code {unknown[0]!r}; known: {', '.join(known)}")
    context = look()
    try:
        with _low_priority(context.daemon is not None), ProgressLine(options, "doctor") as progress:
            chosen = progress.each(runner.select_checks(checks, options.only), lambda check: check.what)
            outcome = runner.run(context, chosen, known)
        if options.only:
            outcome.found = [each for each in outcome.found if each.code in {*options.only, "CHECK_BROKEN"}]
            outcome.because = {}
        here = command_hint(options, context.sockets or None)
        outcome.found, outcome.fix = report.add_commands(
            outcome.found, known, here, options.only, daemon=context.daemon is not None
        )
    finally:
        context.close()
    mended = None
    if options.fix and confirm_fixes(outcome, known, asks):
        with _low_priority(context.daemon is not None):
            mended = runner.mend(outcome, look, checks, known)
    text = report.text(outcome, known, mended, verbose=options.verbose)
    show(options, report.data(outcome, known, mended), text)
    return DONE if outcome.looked and not report.count_problems(outcome, known, mended) else REFUSED


@contextmanager
def _low_priority(beside: bool) -> Iterator[None]:
    """Lower the priority of this process beside a daemon, whose loop must not become late."""
    before = os.getpriority(os.PRIO_PROCESS, 0)
    if beside:
        os.setpriority(os.PRIO_PROCESS, 0, max(before, NICE))
    try:
        yield
    finally:
        with suppress(PermissionError):  # only root may raise it again; this process ends soon
            os.setpriority(os.PRIO_PROCESS, 0, before)


def confirm_fixes(outcome: "DoctorReport", rows: "Mapping[str, Check]", asks: bool) -> bool:
    """Return the consent to all fixes: print them with their cautions and read the answer, if `asks`."""
    fixed = [found for found in outcome.found if found.fix is not None]
    todo = [f"{found.thing}: {found.fix.text}" for found in fixed if found.fix is not None]
    todo += dict.fromkeys(f"first: {rows[each.code].caution}" for each in fixed if rows[each.code].caution)
    if not todo or not asks:
        return True
    print("\n".join(["--fix would do:", *(f"    {each}" for each in todo)]))
    print("do all of this? [y/N] ", end="", flush=True)
    return sys.stdin.readline().strip().lower() in ("y", "yes")  # the end of the input is no consent
