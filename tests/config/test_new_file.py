"""A file that twind makes in a folder where others may write: no link that they place is followed."""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from twind.command_line.trajectory_files import write_trajectory
from twind.config.atomic_save import save_text
from twind.exceptions import OperationFailed
from twind.flight import FlightContents, save
from twind.learn.streaming.spool import FILE, LOCK, Spool, SpoolLimits
from twind.learn.training.training_folder import TrainingFolder
from twind.new_file import open_new, write_new
from twind.observe.writing.record_file import BufferedFile
from twind.virtual.pty_port import VirtualPtyPort

SECRET = "not to be written to\n"
NOBODY = 65534
ROUNDS = 300
# Puts links, hard links and files of its own in the way, as fast as it can, until its input ends.
RACER = """
import os, select, sys
path, victim = sys.argv[1:]
print("begun", flush=True)
while not select.select([0], [], [], 0)[0]:
    for place in (lambda: os.symlink(victim, path), lambda: os.link(victim, path)):
        try:
            place()
        except OSError:
            pass
"""


@pytest.fixture
def shared(tmp_path: Path) -> Path:
    """A folder where every user may write, without the sticky bit: the kernel protects nothing in it."""
    folder = tmp_path / "shared"
    folder.mkdir()
    folder.chmod(0o777)
    for each in (tmp_path, *tmp_path.parents[:2]):
        with suppress(PermissionError):
            each.chmod(each.stat().st_mode | 0o011)
    return folder


@pytest.fixture
def victim(tmp_path: Path) -> Path:
    path = tmp_path / "victim"
    path.write_text(SECRET)
    return path


@contextmanager
def raced(path: Path, victim: Path) -> Iterator[None]:
    """Another user, where this one is root, places links to `victim` at `path` all the time."""
    other = {"user": NOBODY, "group": NOBODY, "extra_groups": []} if os.geteuid() == 0 else {}
    python = "/usr/bin/python3" if other else sys.executable  # that user may not read this environment
    if not Path(python).exists():
        pytest.skip(f"no {python} for another user")
    racer = subprocess.Popen(
        [python, "-Ic", RACER, str(path), str(victim)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        **other,  # type: ignore[call-overload]
    )
    assert racer.stdin is not None and racer.stdout is not None
    try:
        assert racer.stdout.readline() == "begun\n"
        yield
    finally:
        racer.stdin.close()
        racer.wait(10)
        racer.stdout.close()


def test_a_link_that_is_placed_again_and_again_is_never_written_through(shared: Path, victim: Path) -> None:
    path = shared / ".robot.yaml.new"
    saved = refused = 0
    with raced(path, victim):
        for number in range(ROUNDS):
            try:
                save_text(shared, "robot", f"number: {number}\n", history=2)
                saved += 1
            except OSError:  # it lost the race: nothing was written
                refused += 1
    print(f"{saved} saved, {refused} refused")
    assert victim.read_text() == SECRET
    assert saved + refused == ROUNDS and saved


WRITERS: dict[str, tuple[str, Callable[[Path], object]]] = {
    "calibration": (".arm.yaml.new", lambda folder: save_text(folder, "arm", "a: 1\n", history=2)),
    "motion": (
        f".wave.json.{os.getpid()}",
        lambda folder: write_trajectory(
            folder / "wave.json", {"joint_names": [], "points": []}, replace=True
        ),
    ),
    "flight file": (
        ".odd.flight.tmp",
        lambda folder: save(folder / "odd.flight", {}, b"", FlightContents()),
    ),
    "policy": (".run.json.new", lambda folder: TrainingFolder(folder).write("run.json", b"{}")),
}


@pytest.mark.parametrize("kind", ["symbolic", "hard", "dangling"])
@pytest.mark.parametrize("what", WRITERS)
def test_a_link_in_the_way_of_a_new_file_is_removed(shared: Path, victim: Path, what: str, kind: str) -> None:
    name, write = WRITERS[what]
    target = shared.parent / "made"
    if kind == "hard":
        os.link(victim, shared / name)
    else:
        (shared / name).symlink_to(victim if kind == "symbolic" else target)
    write(shared)
    assert victim.read_text() == SECRET
    assert not target.exists()
    assert not (shared / name).exists()
    assert [path for path in shared.iterdir() if path.is_symlink()] == []


LOCKS: dict[str, tuple[str, Callable[[Path], object]]] = {
    "recording": ("odd.mcap", lambda folder: BufferedFile(folder / "odd.mcap")),
    "port of a virtual robot": (".main.lock", lambda folder: VirtualPtyPort("main", folder / "main")),
    "spool": (FILE, lambda folder: Spool(folder, SpoolLimits(1 << 20, 1e9), 0.0, 0.0)),
    "lock of a spool": (LOCK, lambda folder: Spool(folder, SpoolLimits(1 << 20, 1e9), 0.0, 0.0)),
}


@pytest.mark.parametrize("what", LOCKS)
@pytest.mark.parametrize("dangling", [False, True])
def test_a_link_in_place_of_a_file_that_stays_is_refused(
    shared: Path, victim: Path, what: str, dangling: bool
) -> None:
    name, make = LOCKS[what]
    target = shared.parent / "made"
    (shared / name).symlink_to(target if dangling else victim)
    with pytest.raises((OSError, OperationFailed)):
        make(shared)
    assert victim.read_text() == SECRET
    assert not target.exists()


def test_a_file_that_another_program_makes_again_and_again_is_an_error_with_a_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "unlink", lambda path, **named: None)  # it is there again at once
    (tmp_path / "odd").touch()
    with pytest.raises(FileExistsError, match="again and again; use a folder where only you may write"):
        open_new(tmp_path / "odd", 0o600)


def test_a_folder_in_the_way_stays(tmp_path: Path) -> None:
    (tmp_path / "odd").mkdir()
    with pytest.raises(OSError):
        write_new(tmp_path / "odd", b"")
    assert (tmp_path / "odd").is_dir()
