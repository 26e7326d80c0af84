"""Machine with planted defects for the doctor: options, runs, other users, planted files and folders."""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from twind.doctor import add_arguments, runner
from twind.doctor.check import DoctorFinding, severity_of
from twind.doctor.check_context import CheckContext, examine
from twind.doctor.host_inspector import HostInspector
from twind.doctor.runner import DoctorReport, FixResult
from twind_drivers.clock import MonotonicClock

BUILT_IN = Path(__file__).parents[2] / "twind/robots"
NOBODY = 65534
ROOT = os.geteuid() == 0
needs_root = pytest.mark.skipif(not ROOT, reason="changes users and device nodes: needs root")


def options(*words: str, socket: object = "/nowhere/at/all") -> argparse.Namespace:
    """Options of `twindctl --socket DIR doctor WORDS`."""
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
    """Findings of the doctor here, of all codes or of some."""
    examined = examine(options(*words, socket=socket), on or HostInspector(), MonotonicClock())
    try:
        return runner.run(examined, runner.select_checks(runner.all_checks(), only), runner.table())
    finally:
        examined.close()


def found(
    *words: str, code: str, socket: object = "/nowhere/at/all", on: HostInspector | None = None
) -> list[DoctorFinding]:
    """The findings of one code."""
    outcome = look(*words, socket=socket, on=on, only=[code])
    assert not [each for each in outcome.found if each.code == "CHECK_BROKEN"], outcome.found
    return [each for each in outcome.found if each.code == code]


def codes(path: object, code: str, on: HostInspector | None = None) -> list[str]:
    """Subjects of the findings of one code about a port."""
    return [each.thing for each in found("--port", str(path), code=code, on=on)]


def mended(
    *words: str, code: str, socket: object = "/nowhere/at/all", on: HostInspector | None = None
) -> list[FixResult]:
    """Outcome of `--fix` for one code, and the finding after it."""

    def again() -> CheckContext:
        return examine(options(*words, socket=socket), on or HostInspector(), MonotonicClock())

    outcome = look(*words, socket=socket, on=on, only=[code])
    outcome.found = [each for each in outcome.found if each.code == code]
    return runner.mend(outcome, again, runner.all_checks(), runner.table())


def wrong(outcome: DoctorReport) -> set[str]:
    """Codes that count, notes left out."""
    rows = runner.table()
    return {each.code for each in outcome.found if severity_of(each, rows).value != "note"}


@contextmanager
def unprivileged(*groups: int) -> Iterator[None]:
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


def spoil(path: Path, change: Callable[[str], str]) -> Path:
    """Change the text of a file, which must differ afterwards."""
    before = path.read_text()
    after = change(before)
    assert after != before, "the change has no effect"
    path.write_text(after)
    return path


def settings(tmp_path: Path, robot: Path, **more: object) -> Path:
    """Write settings with state folder and sockets in `tmp_path`."""
    lines = [f"robot: {robot}", f"state_dir: {tmp_path / 'state'}", f"sockets: {tmp_path / 'run'}"]
    lines += [f"{key}: {value}" for key, value in more.items()]
    return plant(tmp_path / "twind.yaml", "\n".join(lines) + "\n")


def copy_h24(tmp_path: Path) -> Path:
    """Copy robot file and model of h24 to a folder of their own, where a test may change them."""
    folder = tmp_path / "robot"
    folder.mkdir()
    for suffix in ("yaml", "xml"):
        shutil.copy(BUILT_IN / f"h24.{suffix}", folder)
    return folder / "h24.yaml"


def run_with_own_mounts(script: str, folder: Path) -> str:
    """Output of a shell script whose mounts only its processes see; `$1` is the folder, `$2` is Python.

    Skips where there are no mount namespaces; a script ends with 77 where it may not mount.
    """
    if shutil.which("unshare") is None:
        pytest.skip("no unshare here")
    command = ["unshare", "--mount", "--propagation", "private", "sh", "-c", script, "sh", str(folder)]
    done = subprocess.run([*command, sys.executable], capture_output=True, text=True, timeout=60, check=False)
    if done.returncode in (77, 1) and not done.stdout:
        pytest.skip(f"no mount namespace here: {done.stderr}")
    return done.stdout
