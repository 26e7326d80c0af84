"""Errors of disk and rights: the remedy of a write is given only where something was written."""

import errno
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NoReturn

import pytest

from twind.command_line.verb import Rejected
from twind.config.robot_file import load_robot
from twind.ctl import robot_file_edit
from twind.ctl.ctl_main import main
from twind.ctl.robot_file_edit import RobotFileEdit
from twind.ctl.verb_catalog import find_verb


def raises(code: int, path: str = "odd") -> object:
    """Return a function that raises the error `code` about `path`, whatever it is given."""

    def run(*_given: object, **_named: object) -> NoReturn:
        raise OSError(code, os.strerror(code), path)

    return run


@pytest.fixture
def verb() -> object:
    found = find_verb("plot")
    assert found is not None
    return found


@pytest.mark.parametrize(
    ("code", "remedy"),
    [
        (errno.ENOSPC, "free space on that disk"),
        (errno.EDQUOT, "raise the quota"),
        (errno.EROFS, "mount that file system writable"),
    ],
)
def test_an_error_that_only_a_write_meets_has_its_remedy_in_every_verb(
    verb: object, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], code: int, remedy: str
) -> None:
    monkeypatch.setattr(verb, "run", raises(code))
    assert main(["plot", "a.mcap"]) == 1
    said = capsys.readouterr().err
    assert f"odd cannot be written: {os.strerror(code)}" in said and remedy in said


@pytest.mark.parametrize("code", [errno.EACCES, errno.EPERM])
def test_a_missing_right_is_not_taken_for_that_of_a_write(
    verb: object, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], code: int
) -> None:
    """It may be a read, a device or a mode that was denied."""
    monkeypatch.setattr(verb, "run", raises(code))
    with pytest.raises(PermissionError, match="odd"):
        main(["plot", "a.mcap"])
    assert "written" not in capsys.readouterr().err


def test_a_robot_file_that_this_user_may_not_write_is_named_with_the_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "pan-tilt.yaml"
    file.write_text(load_robot("pan-tilt").path.read_text())
    before = file.read_text()
    edit = RobotFileEdit(file)
    edit.put("support", "gantry")
    monkeypatch.setattr(robot_file_edit, "write_new", raises(errno.EACCES))
    with pytest.raises(Rejected, match=r"pan-tilt\.yaml cannot be written: Permission denied; try with sudo"):
        edit.save()
    assert file.read_text() == before


def test_a_folder_for_a_new_robot_that_this_user_may_not_make_is_named_with_the_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(tempfile, "TemporaryDirectory", raises(errno.EACCES))
    assert main(["robot", "new", "odd", "--folder", str(tmp_path / "odd")]) == 1
    assert f"{tmp_path / 'odd'} cannot be made: Permission denied; try with sudo" in capsys.readouterr().err


def without_reader(code: str, *, out: int | None = None) -> subprocess.CompletedProcess[str]:
    """Run Python code whose standard output is `out`, else a pipe that nobody reads."""
    reading, writing = os.pipe()
    os.close(reading)
    try:
        words = [sys.executable, "-c", code]
        stdout = writing if out is None else out
        return subprocess.run(
            words, stdout=stdout, stderr=subprocess.PIPE, text=True, timeout=60.0, check=False
        )
    finally:
        os.close(writing)


REFUSED_AS_JSON = """
from twind.ctl.ctl_main import main
raise SystemExit(main(["--json", "check", "robot", "/no/such.yaml"]))
"""


def test_a_refusal_that_standard_output_does_not_take_goes_to_standard_error() -> None:
    full = os.open("/dev/full", os.O_WRONLY)
    try:
        for found in (without_reader(REFUSED_AS_JSON), without_reader(REFUSED_AS_JSON, out=full)):
            assert found.returncode == 1
            assert found.stderr.startswith("twindctl: ") and "/no/such.yaml" in found.stderr
            assert "Traceback" not in found.stderr and "Exception" not in found.stderr
    finally:
        os.close(full)


INTERRUPTED_VERB = """
from twind.command_line import verb as verbs
from twind.ctl import ctl_main, verb_catalog

def reports(options):
    print("{}", flush=True)
    return 0

def result(options):
    verbs.show(options, {}, "")
    return RESULT

name = NAME
found = verb_catalog.find_verb(name)
made = verbs.FunctionVerb(found.group, "x", found.add_arguments, DO)
ctl_main.find_verb = lambda _name: made
raise SystemExit(ctl_main.main([name, *MORE]))
"""


@pytest.mark.parametrize(
    ("name", "more", "do", "result", "code"),
    [
        ("move", ["head_yaw=1"], "reports", 0, 1),  # the robot holds on its way
        ("move", ["head_yaw=1"], "result", 0, 0),
        ("move", ["head_yaw=1"], "result", 1, 1),
        ("watch", [], "reports", 0, 0),
    ],
)
def test_a_verb_whose_reader_is_gone_is_done_only_if_it_did_its_work(
    name: str, more: list[str], do: str, result: int, code: int
) -> None:
    text = INTERRUPTED_VERB
    for key, value in (("NAME", repr(name)), ("MORE", repr(more)), ("DO", do), ("RESULT", str(result))):
        text = text.replace(key, value)
    found = without_reader(text)
    assert found.returncode == code, found.stderr
    assert "Traceback" not in found.stderr and "Exception" not in found.stderr
