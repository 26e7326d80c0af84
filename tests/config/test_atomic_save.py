"""Saving survives a power cut at every system call: old or new, never mixed."""

import errno
import os
import resource
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from twind.config import atomic_save
from twind.config.atomic_save import lock_folder, save_text
from twind.config.yaml_tree import ConfigError

OLD = "old\n" * 500
NEW = "new\n" * 700
CALLS = ("open", "write", "fsync", "pread", "link", "replace", "unlink", "listdir", "close")


class PowerCut(BaseException):
    """The machine is off: nothing after this happens, no clean-up either."""


class Disk:
    """`os` whose power fails before the n-th call; what was not synced is then lost, at its worst.

    Written data is short by half until `fsync` of the file. A rename survives at once: the harsher case.
    """

    def __init__(self, folder: Path, calls: int) -> None:
        self.folder = folder
        self.left = calls
        self.order = list[str]()
        self.unsynced: dict[int, str] = {}
        self.opened: set[int] = set()
        self.lost: list[str] = []

    def __getattr__(self, name: str) -> Any:
        real = getattr(os, name)
        if name not in CALLS:
            return real

        def call(*args: Any, **kwargs: Any) -> Any:
            if self.left == 0:
                self.cut()
            self.left -= 1
            self.order.append(name)
            result = real(*args, **kwargs)
            if name == "open":
                self.opened.add(result)
            elif name == "close":
                self.opened.discard(args[0])
            if name == "open" and kwargs.get("dir_fd") is not None:
                self.unsynced[result] = args[0]
            elif name == "fsync":
                self.unsynced.pop(args[0], None)
            elif name == "replace":
                self.unsynced = {fd: args[1] if at == args[0] else at for fd, at in self.unsynced.items()}
            return result

        return call

    def cut(self) -> None:
        for name in self.unsynced.values():
            path = self.folder / name
            path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
        self.unsynced.clear()
        for fd in self.opened:
            os.close(fd)  # nobody holds anything any more
        self.opened.clear()
        raise PowerCut


def calls_of_a_save(folder: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    disk = Disk(folder, -1)
    with monkeypatch.context() as patch:
        patch.setattr(atomic_save, "os", disk)
        save_text(folder, "h24", NEW, 20)
    return disk.order


def test_a_power_cut_at_any_call_leaves_the_old_or_the_new_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    probe = tmp_path / "probe"
    probe.mkdir()
    save_text(probe, "h24", OLD, 20)
    total = len(calls_of_a_save(probe, monkeypatch))
    seen = set()
    for calls in range(total):
        folder = tmp_path / str(calls)
        folder.mkdir()
        save_text(folder, "h24", OLD, 20)
        with monkeypatch.context() as patch:
            patch.setattr(atomic_save, "os", Disk(folder, calls))
            with pytest.raises(PowerCut):
                save_text(folder, "h24", NEW, 20)
        text = (folder / "h24.yaml").read_text()
        assert text in (OLD, NEW)
        seen.add(text)
        save_text(folder, "h24", NEW, 20)  # and after the power is back all works
        assert (folder / "h24.yaml").read_text() == NEW
        assert OLD in [path.read_text() for path in folder.glob("h24.0*.yaml")]
    assert seen == {OLD, NEW}


def test_the_data_is_on_the_disk_before_it_gets_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    order = calls_of_a_save(tmp_path, monkeypatch)
    assert order.index("write") < order.index("fsync") < order.index("replace")
    assert "fsync" in order[order.index("replace") :]


def test_a_full_disk_keeps_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    save_text(tmp_path, "h24", OLD, 20)

    def full(fd: int, data: bytes) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "write", full)
        with pytest.raises(OSError, match="No space left"):
            save_text(tmp_path, "h24", NEW, 20)
    assert (tmp_path / "h24.yaml").read_text() == OLD


def test_a_disk_that_reads_back_differently_keeps_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    save_text(tmp_path, "h24", OLD, 20)
    with monkeypatch.context() as patch:
        patch.setattr(os, "pread", lambda fd, size, offset: b"rot")
        with pytest.raises(ConfigError, match="reads back other than it was written"):
            save_text(tmp_path, "h24", NEW, 20)
    assert (tmp_path / "h24.yaml").read_text() == OLD


def test_history_is_numbered_and_bounded(tmp_path: Path) -> None:
    for number in range(7):
        save_text(tmp_path, "h24", f"{number}\n", 3)
    assert (tmp_path / "h24.yaml").read_text() == "6\n"
    history = sorted(tmp_path.glob("h24.0*.yaml"))
    assert [path.name for path in history] == ["h24.0004.yaml", "h24.0005.yaml", "h24.0006.yaml"]
    assert [path.read_text() for path in history] == ["3\n", "4\n", "5\n"]


def test_the_file_is_for_owner_and_group(tmp_path: Path) -> None:
    before = os.umask(0)
    try:
        path = save_text(tmp_path, "h24", NEW, 20)
    finally:
        os.umask(before)
    assert path.stat().st_mode & 0o777 == 0o640


@pytest.mark.parametrize(
    "name", ["", "../h24", "H24", "a/b", "a" * 65, ".h24", "h24\n", "h24.0001", "h24.", "a..b"]
)
def test_a_name_that_is_no_file_name_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(ConfigError, match="is no name for a file"):
        save_text(tmp_path, name, NEW, 20)
    assert list(tmp_path.iterdir()) == []


def test_a_name_with_a_dot_keeps_its_own_history(tmp_path: Path) -> None:
    save_text(tmp_path, "my_robot.calibration", OLD, 20)
    save_text(tmp_path, "my_robot.calibration", NEW, 20)
    assert (tmp_path / "my_robot.calibration.yaml").read_text() == NEW
    assert (tmp_path / "my_robot.calibration.0001.yaml").read_text() == OLD


def test_a_folder_that_is_missing_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        save_text(tmp_path / "absent", "h24", NEW, 20)


@pytest.mark.parametrize("how", ["text", "draft"])
def test_a_disk_without_room_keeps_the_old_file_and_leaves_nothing_beside_it(
    tmp_path: Path, how: str
) -> None:
    save_text(tmp_path, "robot", "old: 1\n", 5)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, before[1]))
    try:
        with lock_folder(tmp_path) as held:
            save = held.save_draft if how == "draft" else partial(held.save_text, history=5)
            with pytest.raises(OSError, match="File too large"):
                save("robot", "x" * 10_000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert [path.name for path in tmp_path.iterdir()] == ["robot.yaml"]
    assert (tmp_path / "robot.yaml").read_text() == "old: 1\n"
