"""`twindctl calibrate show`, `diff`, `rollback`: whatever was in force can be seen and put back."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.support.h24_calibration import ROBOT, made
from twind.config.calibration_file import Calibration, dump_calibration, load_calibration, save_calibration
from twind.ctl.ctl_main import main
from twind_calibration.calibrating.calibration_actuators import slots
from twind_calibration.calibrating.calibration_diff import changes

SHOWN = {"sign": "gravity", "slope_ratio": 0.94}
Verb = Callable[..., tuple[int, str, str]]


def proved(calibration: Calibration) -> Calibration:
    first, *rest = calibration.joints
    return replace(calibration, joints=(replace(first, proof=SHOWN), *rest))


@pytest.fixture
def files(tmp_path: Path) -> Path:
    """Three in a row: zeros from 2048, from 2050, and the same with a proof."""
    for each in (made(2048), made(2050), proved(made(2050))):
        save_calibration(each, tmp_path, "h24")
    return tmp_path / "h24.yaml"


@pytest.fixture
def verb(files: Path, capsys: pytest.CaptureFixture[str]) -> Verb:
    def call(*words: str) -> tuple[int, str, str]:
        code = main(["calibrate", *words, "--robot", "h24", "--calibration", str(files)])
        said = capsys.readouterr()
        return code, said.out, said.err

    return call


def held(file: Path) -> Calibration:
    return load_calibration(file, ROBOT)


# ------------------------------------------------------------------------------------------- show


def test_show_has_a_row_for_each_joint_and_names_the_earlier_files(verb: Verb, files: Path) -> None:
    code, out, _ = verb("show")
    lines = out.splitlines()
    assert code == 0
    assert lines[0].startswith(f"{files}: h24, 2026-11-21T09:14:03Z, by twind 0.1.0")
    assert [line.split()[0] for line in lines[2:26]] == list(ROBOT.names)
    assert lines[2].split()[-1] == "gravity"
    assert lines[3].split()[-1] == "no"
    assert lines[-1] == "earlier files: 0001, 0002"


def test_show_as_json_is_the_whole_file(verb: Verb) -> None:
    code, out, _ = verb("show", "1", "--json")
    told = json.loads(out)
    assert (code, told["earlier"], len(told["joints"])) == (0, [1, 2], 24)
    assert told["joints"][0]["zero_ticks"] == 2048
    assert told["joints"][0]["device"]["operating_mode"] == 3


@pytest.mark.parametrize("which", ["7", "latest", "0"])
def test_a_number_that_is_not_there_is_refused_with_those_that_are(verb: Verb, which: str) -> None:
    code, _, err = verb("show", which)
    assert (code, "there are: 0001, 0002" in err) == (1, True)


# ------------------------------------------------------------------------------------------- diff


def json_output(out: str) -> Any:
    return json.loads(out)["changes"]


def test_diff_is_by_default_what_the_last_write_changed(verb: Verb) -> None:
    code, out, _ = verb("diff", "--json")
    assert code == 0
    assert json_output(out) == [{"joint": ROBOT.names[0], "what": "proof", "before": None, "after": SHOWN}]


def test_diff_reports_ticks_and_degrees_at_the_joint(verb: Verb) -> None:
    _, out, _ = verb("diff", "1", "2", "--json")
    zeros = [each for each in json_output(out) if each["what"] == "zero_ticks"]
    assert [each["joint"] for each in zeros] == list(ROBOT.names)
    for each, joint in zip(zeros, ROBOT.joints, strict=True):
        assert each["after"] - each["before"] == 2
        assert each["degrees"] == pytest.approx(2 * joint.sign / joint.ratio * 360 / 4096, abs=1e-4)
    _, out, _ = verb("diff", "1", "2")
    assert f"  zero_ticks: 2048 -> 2050 (+2 ticks, {360 * 2 / 4096 * ROBOT.joints[0].sign:+.2f} deg)" in out


def test_equal_files_are_reported_as_equal_and_a_path_may_be_named(verb: Verb, files: Path) -> None:
    code, out, _ = verb("diff", "current", str(files))
    assert (code, out.splitlines()[1:]) == (0, ["nothing differs"])


def test_every_value_of_an_entry_that_differs_is_found() -> None:
    """A key that is added to the file and forgotten here is told by this."""
    old = made(2048)
    first, *rest = old.joints
    for name in ("zero_ticks", "zero_sigma_ticks", "captures", "sign", "method", "proof", "device"):
        other = {
            "method": "jig",
            "proof": SHOWN,
            "device": replace(first.device, firmware=47),
        }.get(name, getattr(first, name))
        changed = other + 1 if isinstance(other, int | float) else other
        new = replace(old, joints=(replace(first, **{name: changed}), *rest))
        assert [each.what for each in changes(old, new, slots(ROBOT))] == [name]
    fewer = replace(old, joints=tuple(rest))
    assert [str(each) for each in changes(old, fewer, slots(ROBOT))] == ["is not there any more"]
    assert [str(each) for each in changes(fewer, old, slots(ROBOT))] == ["is new"]


# ------------------------------------------------------------------------------------------- rollback


def test_rollback_puts_an_earlier_file_back_and_keeps_what_it_replaces(verb: Verb, files: Path) -> None:
    before = files.read_text()
    earlier = files.with_name("h24.0001.yaml").read_text()
    code, out, _ = verb("rollback", "1", "--yes")
    assert code == 0, out
    assert files.read_text() == earlier
    assert files.with_name("h24.0001.yaml").read_text() == earlier
    assert files.with_name("h24.0003.yaml").read_text() == before
    assert "it is in force when the daemon starts again" in out
    assert verb("rollback", "3", "--yes")[0] == 0  # and back again
    assert files.read_text() == before


def test_rollback_mends_a_file_that_cannot_be_read(verb: Verb, files: Path) -> None:
    files.write_text(files.read_text().replace("zero_ticks: 2050", "zero_ticks: 2051"))
    broken = files.read_text()
    assert verb("show")[0] == 1
    code, out, _ = verb("rollback", "2", "--yes")
    assert (code, "is not the hash of this file" in out) == (0, True)
    assert held(files).joints[0].zero_ticks == 2050
    assert files.with_name("h24.0003.yaml").read_text() == broken


def test_an_earlier_file_of_another_description_or_edited_is_refused(verb: Verb, files: Path) -> None:
    before = files.read_text()
    other = replace(made(), robot_description_sha256="0" * 64)
    files.with_name("h24.0001.yaml").write_text(dump_calibration(other))
    edited = files.with_name("h24.0002.yaml")
    edited.write_text(edited.read_text().replace("captures: 1", "captures: 9"))
    for which, why in (("1", "joints, ids, signs or ratios changed since"), ("2", "is not the hash")):
        code, _, err = verb("rollback", which, "--yes")
        assert (code, why in err) == (1, True), err
    assert files.read_text() == before


def test_without_a_yes_nothing_is_written(verb: Verb, files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = files.read_text()
    assert verb("rollback", "1")[0] == 2  # nobody to ask
    assert verb("rollback", "1", "--json")[0] == 2
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    monkeypatch.setattr("sys.stdin.readline", lambda: "n\n", raising=False)
    code, out, err = verb("rollback", "1")
    assert (code, "nothing was written" in err) == (1, True)
    assert "zero_ticks: 2050 -> 2048" in out
    assert files.read_text() == before


def test_an_unwritable_folder_suggests_sudo(verb: Verb, files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: Any, **__: Any) -> Path:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("twind.config.atomic_save.LockedFolder.save_text", refused)
    code, _, err = verb("rollback", "1", "--yes")
    assert (code, "try with sudo" in err) == (1, True)


def test_a_missing_calibration_file_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--robot", "h24", "--calibration", str(tmp_path / "none.yaml")]
    assert main(["calibrate", "show", *words]) == 1
    assert main(["calibrate", "diff", *words]) == 1
    assert "no earlier file to compare with" in capsys.readouterr().err
