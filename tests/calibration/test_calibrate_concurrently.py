"""Two programs that write one calibration: no entry is lost, and no file mixes both."""

import os
import stat
import threading
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.support.h24_calibration import ROBOT, made
from twind.command_line.verb import Rejected
from twind.config import atomic_save
from twind.config.atomic_save import FileOwnership, draft_of, lock_folder, save_text
from twind.config.calibrated_device import DeviceRecord
from twind.config.calibration_file import Calibration, load_calibration, save_calibration
from twind.ctl.ctl_main import main
from twind_calibration.calibrating import calibration_draft as drafts
from twind_calibration.calibrating import (
    file_ownership,
    history_command,
    import_command,
    limits_command,
)
from twind_calibration.calibrating.calibration_context import CalibrationContext
from twind_calibration.calibrating.calibration_conversion import ImportResult
from twind_calibration.calibrating.calibration_draft import CalibrationDraft, DraftTravel
from twind_calibration.calibrating.calibration_steps import STEPS
from twind_calibration.calibrating.entry_writer import write_entries

Captured = pytest.CaptureFixture[str]
KNEE = "l_knee"
ELBOW = "l_elbow"
AT = "2026-11-21T09:14:03Z"


@pytest.fixture
def place(tmp_path: Path) -> CalibrationContext:
    """A robot that is calibrated."""
    return CalibrationContext(ROBOT, save_calibration(made(), tmp_path, "h24"), named=True)


def known(place: CalibrationContext) -> Calibration:
    calibration = place.calibration()
    assert calibration is not None
    return calibration


def moved(calibration: Calibration, name: str, ticks: int) -> Any:
    """Its entry with another zero."""
    entry = calibration.by_name[name]
    return replace(entry, zero_ticks=entry.zero_ticks + ticks)


def draft_travel(name: str, calibration: Calibration, longer: int = 0) -> DraftTravel:
    entry = calibration.by_name[name]
    return DraftTravel(entry.device, (entry.sweep_ticks[0], entry.sweep_ticks[1] + longer), AT)


# ------------------------------------------------------------------------------------------- two people


def test_entries_saved_by_another_process_during_a_prompt_are_kept(place: CalibrationContext) -> None:
    mine = known(place)
    theirs = known(place)
    write_entries(place, theirs, [moved(theirs, ELBOW, 50)])
    after = write_entries(place, mine, [moved(mine, KNEE, 3)])
    assert after == known(place)
    assert after.by_name[ELBOW] == moved(mine, ELBOW, 50)
    assert after.by_name[KNEE] == moved(mine, KNEE, 3)


@pytest.mark.parametrize("theirs", ["replaced", "struck out", "no file any more"])
def test_an_entry_that_another_changed_meanwhile_is_not_replaced(
    place: CalibrationContext, theirs: str
) -> None:
    mine = known(place)
    if theirs == "replaced":
        write_entries(place, mine, [moved(mine, KNEE, 50)])
    elif theirs == "struck out":
        file_ownership.save(
            replace(mine, joints=[each for each in mine.joints if each.name != KNEE]), place.path
        )
    else:
        place.path.unlink()
    before = place.path.read_bytes() if place.path.exists() else None
    with pytest.raises(Rejected, match=r"calibrated l_knee meanwhile: .*nothing was written"):
        write_entries(place, mine, [moved(mine, KNEE, 3)])
    assert (place.path.read_bytes() if place.path.exists() else None) == before


def test_a_rollback_does_not_discard_entries_saved_during_its_prompt(
    place: CalibrationContext, monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    file_ownership.save(made(2050), place.path)
    rollback = ["calibrate", "rollback", "1", "--robot", "h24", "--calibration", str(place.path), "--yes"]

    def asked(*_: Any) -> bool:
        write_entries(place, known(place), [moved(known(place), KNEE, 50)])
        return True

    with monkeypatch.context() as patch:
        patch.setattr(history_command, "agreed", asked)
        assert main(rollback) == 1
    assert "another program wrote" in capsys.readouterr().err
    assert known(place).by_name[KNEE] == moved(made(2050), KNEE, 50)
    assert main(rollback) == 0
    assert known(place).by_name == made().by_name


def replace_limits_peers(
    monkeypatch: pytest.MonkeyPatch, place: CalibrationContext, daemon: object, **more: Callable[..., Any]
) -> None:
    """Replace the daemon and the devices of `calibrate limits`; `more`: further functions by name."""
    devices = {each.name: each.device for each in known(place).joints}
    peers: dict[str, Callable[..., Any]] = {
        "operator": lambda _: nullcontext(daemon),
        "ground": lambda *_: place,
        "records": lambda *_: devices,
        "require_limp": lambda *_: None,
        "limp": lambda *_, **__: nullcontext(lambda: None),
    }
    for name, stands in (peers | more).items():
        monkeypatch.setattr(limits_command, name, stands)


def test_no_servo_is_fenced_from_a_zero_that_another_replaced(
    place: CalibrationContext, monkeypatch: pytest.MonkeyPatch
) -> None:
    mine = known(place)
    calls = list[str]()

    class Daemon:
        def call(self, method: str, **_: Any) -> dict[str, Any]:
            calls.append(method)
            return {"status": {"mode": "live"}}

    def asked(*_: Any) -> bool:
        write_entries(place, mine, [moved(mine, KNEE, 50)])
        return True

    replace_limits_peers(monkeypatch, place, Daemon(), agreed=asked)
    with pytest.raises(Rejected, match="another program calibrated l_knee meanwhile"):
        limits_command.limits(options("limits", KNEE, "--yes"))
    assert "WriteRegister" not in calls
    assert known(place).by_name[KNEE] == moved(mine, KNEE, 50)


def test_the_folder_is_held_while_servos_are_fenced(
    place: CalibrationContext, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From the last look at the zero until the limits are recorded."""
    mine = known(place)
    refused = list[str]()
    monkeypatch.setattr(atomic_save, "PATIENCE", 0.0)

    class Daemon:
        def call(self, method: str, **how: Any) -> dict[str, Any]:
            if method != "WriteRegister":
                return {"status": {"mode": "live"}}
            with pytest.raises(Rejected, match="another program saves there"):
                write_entries(place, mine, [moved(mine, KNEE, 50)])
            refused.append(how["name"])
            return {"register": {"value": how["value"]}}

    replace_limits_peers(monkeypatch, place, Daemon(), next_steps=lambda *_: None)
    assert limits_command.limits(options("limits", KNEE, "--yes")) == 0
    assert sorted(refused) == ["max_position_limit", "min_position_limit"]
    assert known(place).by_name[KNEE].zero_ticks == mine.by_name[KNEE].zero_ticks


def options(step: str, *words: str) -> Namespace:
    """Options of a step, as its parser gives them."""
    parser = ArgumentParser()
    parser.add_argument("--socket")
    parser.add_argument("--json", action="store_true")
    STEPS[step].add_arguments(parser)
    return parser.parse_args(words)


# ------------------------------------------------------------------------------------------- drafts


def test_two_concurrent_sweeps_are_both_in_the_draft(place: CalibrationContext) -> None:
    one = draft_travel(KNEE, known(place))
    two = draft_travel(ELBOW, known(place))
    drafts.change(place.path, ROBOT, lambda found: found.joined(KNEE, one))
    held = drafts.change(place.path, ROBOT, lambda found: found.joined(ELBOW, two))
    assert held == drafts.load(place.path, ROBOT) == CalibrationDraft({KNEE: one, ELBOW: two})


def test_a_joint_recorded_again_since_stays_in_the_draft() -> None:
    calibration = made()
    then = CalibrationDraft({KNEE: draft_travel(KNEE, calibration), ELBOW: draft_travel(ELBOW, calibration)})
    since = then.joined(KNEE, draft_travel(KNEE, calibration, longer=9))
    assert since.after(then, [KNEE, ELBOW]) == CalibrationDraft(
        {KNEE: draft_travel(KNEE, calibration, longer=9)}
    )


@pytest.mark.parametrize("mode", [0o604, 0o660])
def test_a_draft_has_the_rights_of_the_calibration_file(place: CalibrationContext, mode: int) -> None:
    """Or one of `sudo twindctl calibrate sweep` could not be read without it."""
    place.path.chmod(mode)
    if os.geteuid() == 0:
        os.chown(place.path, 65534, 65533)
    drafts.change(place.path, ROBOT, lambda _: CalibrationDraft({KNEE: draft_travel(KNEE, made())}))
    file = place.path.stat()
    draft = draft_of(place.path.parent, "h24").stat()
    assert (draft.st_uid, draft.st_gid) == (file.st_uid, file.st_gid)
    assert stat.S_IMODE(draft.st_mode) == mode


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files away")
def test_the_first_draft_of_root_belongs_to_the_folder_owner(tmp_path: Path) -> None:
    os.chown(tmp_path, 65534, 65533)
    drafts.change(
        tmp_path / "h24.yaml", ROBOT, lambda _: CalibrationDraft({KNEE: draft_travel(KNEE, made())})
    )
    left = draft_of(tmp_path, "h24").stat()
    assert (left.st_uid, left.st_gid) == (65534, 65533)


def test_an_unreadable_file_asks_for_sudo_and_is_not_reported_as_broken(
    place: CalibrationContext, monkeypatch: pytest.MonkeyPatch
) -> None:
    def denied(*_: Any) -> bytes:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("twind.config.yaml_tree.read_plain", denied)
    for read in (lambda: drafts.load(place.path, ROBOT), place.calibration):
        with pytest.raises(Rejected, match=r"Permission denied; try with sudo$") as caught:
            read()
        assert "remove" not in str(caught.value) and "move this one" not in str(caught.value)


# ------------------------------------------------------------------------------------------- at once


@contextmanager
def saving_beside(monkeypatch: pytest.MonkeyPatch, act: Callable[[], object]) -> Iterator[list[object]]:
    """The first save is held before its file has its name, and `act` begun meanwhile, elsewhere."""
    done = list[object]()
    real = os.replace
    others = list[threading.Thread]()

    def replace_file(*arguments: Any, **folders: Any) -> None:
        if not others:
            others.append(threading.Thread(target=lambda: done.append(act())))
            others[0].start()
            others[0].join(0.2)
            assert not done, "it did not wait"
        real(*arguments, **folders)

    monkeypatch.setattr(os, "replace", replace_file)
    yield done
    others[0].join(10.0)


def test_two_concurrent_saves_are_serialised_and_both_are_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = "first\n" * 900
    second = "second\n" * 700
    with saving_beside(monkeypatch, lambda: save_text(tmp_path, "h24", second, 20)) as done:
        save_text(tmp_path, "h24", first, 20)
    assert done == [tmp_path / "h24.yaml"]
    assert (tmp_path / "h24.yaml").read_text() == second
    assert (tmp_path / "h24.0001.yaml").read_text() == first


def test_an_entry_written_during_a_save_is_merged_with_the_saved_file(
    place: CalibrationContext, monkeypatch: pytest.MonkeyPatch
) -> None:
    mine = known(place)
    with saving_beside(monkeypatch, lambda: write_entries(place, mine, [moved(mine, ELBOW, 50)])):
        write_entries(place, mine, [moved(mine, KNEE, 3)])
    after = known(place)
    assert after.by_name[KNEE] == moved(mine, KNEE, 3)
    assert after.by_name[ELBOW] == moved(mine, ELBOW, 50)


def test_a_save_that_waits_too_long_for_the_lock_reports_the_cause(
    place: CalibrationContext, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(atomic_save, "PATIENCE", 0.05)
    before = place.path.read_bytes()
    with (
        lock_folder(place.path.parent),
        pytest.raises(Rejected, match=r"h24\.yaml cannot be written: another"),
    ):
        file_ownership.save(made(2050), place.path)
    assert place.path.read_bytes() == before
    file_ownership.save(made(2050), place.path)
    assert known(place).by_name["head_yaw"].zero_ticks == made(2050).by_name["head_yaw"].zero_ticks


def test_a_folder_is_free_again_whatever_ended_a_save(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(atomic_save, "PATIENCE", 0.0)
    (tmp_path / ".h24.yaml.new").mkdir()
    with pytest.raises(IsADirectoryError):
        save_text(tmp_path, "h24", "text\n", 20)
    (tmp_path / ".h24.yaml.new").rmdir()
    save_text(tmp_path, "h24", "text\n", 20, FileOwnership(0o600))


# ------------------------------------------------------------------------------------------- import


LIMITED = (1900, 3400)  # position limits that a knee's travel could be
OTHERWISE = DeviceRecord(1020, 46, None, 0, 0, 3, *LIMITED)


@pytest.mark.parametrize(
    ("change", "travel", "message"),
    [
        ({}, (1910, 3390), ""),
        ({"firmware": 47}, LIMITED, "position limits; not what was swept, its servo is not as it"),
        ({"homing_offset_ticks": 5}, LIMITED, "homing_offset is 0, was 5"),
        (None, LIMITED, "the travel is its position limits\n"),
    ],
)
def test_the_travel_of_a_servo_changed_since_its_sweep_is_rejected_and_reported(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: Captured,
    change: dict[str, Any] | None,
    travel: tuple[int, int],
    message: str,
) -> None:
    place = CalibrationContext(ROBOT, tmp_path / "h24.yaml", named=True)
    if change is not None:
        then = replace(OTHERWISE, **change)
        drafts.change(
            place.path, ROBOT, lambda found: found.joined(KNEE, DraftTravel(then, (1910, 3390), AT))
        )
    for name, stands in {
        "operator": lambda _: nullcontext(None),
        "ground": lambda *_: place,
        "records": lambda *_: {KNEE: OTHERWISE},
        "next_steps": lambda *_: None,
    }.items():
        monkeypatch.setattr(import_command, name, stands)
    words = ["--from", "servo", "--zero-at", "2000", "--yes", KNEE]
    assert import_command.take(options("import", *words)) == 0
    out = capsys.readouterr().out
    assert load_calibration(place.path, ROBOT).by_name[KNEE].sweep_ticks == travel
    assert message in out and ("position limits" in out) == bool(message)
    assert not draft_of(tmp_path, "h24").exists()


def test_a_refused_import_also_reports_an_omitted_sweep(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    now = replace(OTHERWISE, min_ticks=0, max_ticks=4095)
    slot = next(each for each in import_command.slots(ROBOT) if each.name == KNEE)
    then = CalibrationDraft({KNEE: DraftTravel(OTHERWISE, (1910, 3390), AT)})
    folded: ImportResult = import_command.fold(slot, {KNEE: now}, {}, then, {KNEE: 2000}, wide=False)
    assert folded.entry is None
    assert "as delivered" in "; ".join(folded.wrong)
    assert "not what was swept" in folded.note
