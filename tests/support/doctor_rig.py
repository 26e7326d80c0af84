"""A machine with something wrong for the doctor to find: options, looks, other users, planted folders."""

import argparse
import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from twind.doctor import add_arguments, check_table, runner
from twind.doctor.check import DoctorFinding
from twind.doctor.check_context import CheckContext
from twind.doctor.context_builder import examine
from twind.doctor.host_inspector import HostInspector
from twind.doctor.runner import DoctorReport, FixResult
from twind_drivers.clock import MonotonicClock

NOBODY = 65534
ROOT = os.geteuid() == 0


def options(*words: str, socket: object = "/nowhere/at/all") -> argparse.Namespace:
    """Of `twindctl --socket DIR doctor WORDS`."""
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    found = parser.parse_args(words)
    found.socket = str(socket)
    found.json = False
    return found


def host(**changed: Any) -> HostInspector:
    """This machine, some of its folders planted."""
    return replace(HostInspector(), **changed)


def look(
    *words: str, socket: object = "/nowhere/at/all", on: HostInspector | None = None, only: Sequence[str] = ()
) -> DoctorReport:
    """What the doctor finds here, of all codes or of some."""
    examined = examine(options(*words, socket=socket), on or HostInspector(), MonotonicClock())
    try:
        return runner.run(
            examined, runner.select_checks(check_table.checks(), only), check_table.complaints()
        )
    finally:
        examined.close()


def found(
    *words: str, code: str, socket: object = "/nowhere/at/all", on: HostInspector | None = None
) -> list[DoctorFinding]:
    """The findings of one code."""
    outcome = look(*words, socket=socket, on=on, only=[code])
    assert not [each for each in outcome.found if each.code == "CHECK_BROKEN"], outcome.found
    return [each for each in outcome.found if each.code == code]


def mended(
    *words: str, code: str, socket: object = "/nowhere/at/all", on: HostInspector | None = None
) -> list[FixResult]:
    """What `--fix` does about one code, and what it sees afterwards."""

    def again() -> CheckContext:
        return examine(options(*words, socket=socket), on or HostInspector(), MonotonicClock())

    outcome = look(*words, socket=socket, on=on, only=[code])
    outcome.found = [each for each in outcome.found if each.code == code]
    return runner.mend(outcome, again, check_table.checks(), check_table.complaints())


def wrong(outcome: DoctorReport) -> set[str]:
    """Codes that count, notes left out."""
    rows = check_table.complaints()
    return {each.code for each in outcome.found if rows[each.code].severity.value != "note"}


@contextmanager
def nobody(*groups: int) -> Iterator[None]:
    """Everything inside is done as the user nobody, with these groups. Needs root."""
    before = (os.getgroups(), os.getegid())
    home = os.environ["HOME"]
    os.environ["HOME"] = "/nonexistent"
    os.setgroups(list(groups))
    os.setegid(NOBODY)
    os.seteuid(NOBODY)
    try:
        yield
    finally:
        os.seteuid(0)
        os.setegid(before[1])
        os.setgroups(before[0])
        os.environ["HOME"] = home


def way_to(folder: Path) -> list[Path]:
    """The folder and those above it that the tests made, whatever runs them: others must enter each."""
    return [folder, *(above for above in folder.parents if Path(tempfile.gettempdir()) in above.parents)]


def plant(folder: Path, text: str) -> Path:
    """A file with its folders."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    folder.write_text(text)
    return folder
