"""A calibration survives a power cut after any system call of its save, and a disk that is full at any.

Afterwards the file is the old or the new one to the byte, it loads, and no earlier one is lost or broken.
"""

import errno
import os
import re
import resource
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.support.h24_calibration import ROBOT, made
from tests.support.power_cut_recorder import Recording, holding, laid_out, recorded
from twind.config import atomic_save
from twind.config.atomic_save import FileOwnership, draft_of, lock_folder, save_text
from twind.config.calibration_file import dump_calibration, load_calibration


def text(zero: int) -> str:
    """A calibration of two joints, another one for each `zero`."""
    whole = made(zero)
    return dump_calibration(replace(whole, joints=whole.joints[:2]))


OLD = text(2048)
NEW = text(2050)
LEFT = text(2049)[:700]
KEPT = 3  # earlier files
NUMBERED = re.compile(r"h24\.\d{4}\.yaml")
Save = Callable[[Path], object]


def save(folder: Path) -> object:
    return save_text(folder, "h24", NEW, KEPT)


def earlier(held: dict[str, bytes]) -> dict[str, bytes]:
    return {name: data for name, data in held.items() if NUMBERED.fullmatch(name)}


def first(folder: Path) -> None:
    """Nothing was ever saved there."""


def second(folder: Path) -> None:
    save_text(folder, "h24", OLD, KEPT)


def after_a_cut(folder: Path) -> None:
    """Half of a file is left of a save that was cut short."""
    second(folder)
    (folder / ".h24.yaml.new").write_text(LEFT)


def full_history(folder: Path) -> None:
    """The oldest has to go."""
    for number in range(KEPT):
        save_text(folder, "h24", text(3000 + number), KEPT)
    second(folder)


PASTS = (first, second, after_a_cut, full_history)


@pytest.fixture(params=PASTS, ids=lambda past: past.__name__)
def recording(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Recording:
    folder = tmp_path / "recorded"
    folder.mkdir()
    request.param(folder)
    return recorded(folder, lambda: save(folder), atomic_save, monkeypatch)


def before(recording: Recording) -> dict[str, bytes]:
    return {name: recording.files[inode] for name, inode in recording.names.items()}


# ------------------------------------------------------------------------------------------- power


def test_after_any_call_the_file_is_old_or_new_and_the_history_whole(
    recording: Recording, tmp_path: Path
) -> None:
    was = before(recording)
    current = was.get("h24.yaml")
    history = earlier(was)
    seen = set()
    for count in range(len(recording.calls) + 1):
        for held in recording.aftermaths(count):
            now = held.get("h24.yaml")
            assert now in (current, NEW.encode()), f"after {count} calls"
            seen.add(now)
            kept = [*earlier(held).values(), *([current] if now == current and current else [])]
            lost = [data for data in [*history.values(), *([current] if current else [])] if data not in kept]
            assert len(lost) <= (1 if len(history) == KEPT and now != current else 0), f"after {count} calls"
            assert all(data in (*history.values(), current) for data in earlier(held).values())
    assert seen == {current, NEW.encode()}


def test_every_state_after_a_power_cut_is_loaded_and_saved_over(recording: Recording, tmp_path: Path) -> None:
    """On a real folder: each that differs in what counts."""
    folders = {
        frozenset(held.items()): held
        for count in range(len(recording.calls) + 1)
        for held in recording.aftermaths(count)
    }
    assert len(folders) >= 5
    for number, held in enumerate(folders.values()):
        folder = laid_out(tmp_path / str(number), held)
        if "h24.yaml" in held:
            load_calibration(folder / "h24.yaml", ROBOT)
        save(folder)
        assert (folder / "h24.yaml").read_text() == NEW
        assert len(earlier(holding(folder))) <= KEPT
        shutil.rmtree(folder)


def test_when_it_returns_it_is_on_the_disk(recording: Recording) -> None:
    left = list(recording.aftermaths(len(recording.calls)))
    assert {held["h24.yaml"] for held in left} == {NEW.encode()}
    old = before(recording).get("h24.yaml")
    assert all(old in earlier(held).values() for held in left if old is not None)


def test_a_draft_is_old_or_new_as_well(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def save_draft(text: str) -> None:
        with lock_folder(tmp_path) as folder:
            folder.save_draft("h24", text)

    save_draft(OLD)
    name = draft_of(tmp_path, "h24").name
    drafted = recorded(tmp_path, lambda: save_draft(NEW), atomic_save, monkeypatch)
    left = [held[name] for count in range(len(drafted.calls) + 1) for held in drafted.aftermaths(count)]
    assert set(left) == {OLD.encode(), NEW.encode()}
    assert {held[name] for held in drafted.aftermaths(len(drafted.calls))} == {NEW.encode()}


def test_the_disk_model_detects_a_save_without_one_of_its_syncs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without any one of its syncs the claims above would not hold: they can fail."""
    second(tmp_path)
    whole = recorded(tmp_path, lambda: save(tmp_path), atomic_save, monkeypatch)
    assert [call.what for call in whole.calls if call.what.startswith("sync")]
    for number, call in enumerate(whole.calls):
        if not call.what.startswith("sync"):
            continue
        calls = (*whole.calls[:number], *whole.calls[number + 1 :])
        lazy = Recording(whole.names, whole.files, calls)
        mixed = False
        for count in range(len(calls) + 1):
            for held in lazy.aftermaths(count):
                now = held.get("h24.yaml")
                kept = earlier(held).values()
                mixed |= now not in (OLD.encode(), NEW.encode())
                mixed |= now == NEW.encode() and OLD.encode() not in kept
                mixed |= count == len(calls) and now != NEW.encode()
        assert mixed, f"without call {number}, {call.what}"


# ------------------------------------------------------------------------------------------- what it calls


def test_a_file_has_its_rights_before_it_has_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else a cut in between would leave one that the daemon may not read."""
    second(tmp_path)
    real = os.replace
    seen = []

    def renamed(source: str, name: str, *, src_dir_fd: int, **where: Any) -> None:
        seen.append(os.stat(source, dir_fd=src_dir_fd).st_mode & 0o777)
        real(source, name, src_dir_fd=src_dir_fd, **where)

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", renamed)
        save_text(tmp_path, "h24", NEW, KEPT, FileOwnership(0o604))
    assert seen == [0o604]
    assert (tmp_path / "h24.yaml").stat().st_mode & 0o777 == 0o604


@pytest.mark.skipif(shutil.which("strace") is None, reason="no strace here")
def test_nothing_else_is_done_to_the_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The kernel is asked: what the recorder sees is all there is."""
    folder = tmp_path / "traced"
    log = tmp_path / "log"
    folder.mkdir()
    second(folder)
    program = (
        "import sys; from pathlib import Path; from twind.config.atomic_save import save_text\n"
        "save_text(Path(sys.argv[1]), 'h24', sys.argv[2], 20)"
    )
    calls = (
        "openat,write,pwrite64,ftruncate,fsync,fdatasync,"
        "link,linkat,rename,renameat,renameat2,unlink,unlinkat"
    )
    trace = ["strace", "-f", "-o", str(log), "-e", f"trace={calls}", "-s", "8"]
    run = subprocess.run(
        [*trace, sys.executable, "-c", program, str(folder), NEW], capture_output=True, text=True, check=False
    )
    if run.returncode != 0 and "ptrace" in run.stderr.lower():
        pytest.skip("nobody may be traced here")
    assert run.returncode == 0, run.stderr
    lines = log.read_text().splitlines()
    opened = next(place for place, line in enumerate(lines) if f'"{folder}", O_RDONLY' in line)
    traced = [re.sub(r"^\d+ +", "", line) for line in lines[opened + 1 :]]
    kinds = [line.partition("(")[0] for line in traced if re.match(r"\w+\(", line)]
    seen = [{"openat": "create", "linkat": "link", "unlinkat": "unlink"}.get(kind, kind) for kind in kinds]
    seen = ["rename" if kind.startswith("rename") else kind for kind in seen]
    other = tmp_path / "other"
    other.mkdir()
    second(other)
    told = recorded(other, lambda: save(other), atomic_save, monkeypatch)
    names = {"sync": "fsync", "sync folder": "fsync"}
    assert seen == [names.get(call.what, call.what) for call in told.calls]


# ------------------------------------------------------------------------------------------- full


CALLS = ("open", "write", "fsync", "pread", "link", "replace", "listdir")


class Failing:
    """`os` whose n-th call of these fails; a write takes half of its bytes first, as a full disk does."""

    def __init__(self, left: int, code: int) -> None:
        self.left = left
        self.code = code

    def __getattr__(self, name: str) -> Any:
        real = getattr(os, name)
        if name not in CALLS:
            return real

        def call(*arguments: Any, **named: Any) -> Any:
            self.left -= 1
            if self.left >= 0:
                return real(*arguments, **named)
            if name == "write":
                real(arguments[0], bytes(arguments[1])[: len(arguments[1]) // 2])
            raise OSError(self.code, os.strerror(self.code))

        return call


def failure(act: Callable[[], object]) -> int:
    """Number of the error that it ends with; 0: with none."""
    try:
        act()
    except OSError as error:
        return error.errno or -1
    return 0


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EIO])
def test_a_disk_that_fails_at_any_call_keeps_a_whole_file_and_raises_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int
) -> None:
    open_before = len(os.listdir("/proc/self/fd"))
    failed = 0
    for left in range(20):
        folder = tmp_path / str(left)
        folder.mkdir()
        full_history(folder)
        history = earlier(holding(folder))
        with monkeypatch.context() as patch:
            patch.setattr(atomic_save, "os", Failing(left, code))
            why = failure(lambda: save(folder))  # noqa: B023 - called at once
        assert why in (0, code)
        failed += why == code
        now = (folder / "h24.yaml").read_text()
        kept = earlier(holding(folder))
        assert now in (OLD, NEW)
        assert now == NEW or not set(history.values()) - set(kept.values())
        assert now == OLD or OLD.encode() in kept.values()
        assert len(os.listdir("/proc/self/fd")) == open_before
    assert failed > 6


@pytest.fixture
def small_files() -> Iterator[Callable[[int], None]]:
    """A kernel that lets no file grow beyond so many bytes."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    yield lambda most: resource.setrlimit(resource.RLIMIT_FSIZE, (most, hard))
    resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize("room", [0, 1, 100, len(NEW) - 1])
def test_a_kernel_that_takes_only_a_part_of_the_bytes_keeps_the_old_file(
    tmp_path: Path, small_files: Callable[[int], None], room: int
) -> None:
    second(tmp_path)
    small_files(room)
    try:
        with pytest.raises(OSError, match="File too large"):
            save(tmp_path)
    finally:
        small_files(resource.RLIM_INFINITY)
    assert (tmp_path / "h24.yaml").read_text() == OLD
    assert earlier(holding(tmp_path)) == {}
    save(tmp_path)
    assert (tmp_path / "h24.yaml").read_text() == NEW


def test_a_disk_without_room_keeps_the_old_file(tmp_path: Path) -> None:
    """A real one of 64 KiB, where one may be mounted."""
    disk = tmp_path / "disk"
    disk.mkdir()
    made = ["mount", "-t", "tmpfs", "-o", "size=64k", "none", str(disk)]
    if os.geteuid() != 0 or subprocess.run(made, capture_output=True, check=False).returncode != 0:
        pytest.skip("no disk may be mounted here")
    try:
        second(disk)
        assert failure(lambda: (disk / "filler").write_bytes(bytes(1 << 17))) == errno.ENOSPC
        with pytest.raises(OSError, match="No space left"):
            save(disk)
        assert (disk / "h24.yaml").read_text() == OLD
        (disk / "filler").unlink()
        save(disk)
        assert (disk / "h24.yaml").read_text() == NEW
    finally:
        subprocess.run(["umount", str(disk)], check=True)
