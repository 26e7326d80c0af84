"""A full or read-only file system: what was there stays, the message has the remedy, the loop goes on."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.support.h24_calibration import made
from tests.support.own_mounts import OwnMounts, own_mounts
from tests.support.processes import Daemon
from twind.config.calibration_file import save_calibration
from twind.observe.recording import open_recording

SHM = Path("/dev/shm")
REMEDY = {
    "full": "No space left on device; free space on that disk",
    "read-only": "Read-only file system; mount that file system writable",
}
KINDS = pytest.mark.parametrize("kind", REMEDY)


@pytest.fixture
def state(tmp_path: Path) -> Path:
    """The state folder, on a disk of its own."""
    path = tmp_path / "state"
    path.mkdir()
    return path


@pytest.fixture
def mounts(state: Path) -> Iterator[OwnMounts]:
    with own_mounts({SHM: "4k", state: "6m"}) as made_:
        made_.fill(SHM)
        yield made_


@pytest.fixture
def begin(mounts: OwnMounts, state: Path, tmp_path: Path) -> Iterator[Callable[[], Daemon]]:
    """Starts a daemon in sim whose state is on that disk."""
    begun: list[Daemon] = []

    def start() -> Daemon:
        options = ("--mode", "sim", "--robot", "pan-tilt")
        environment = {"STATE_DIRECTORY": str(state)}
        begun.append(Daemon(tmp_path / "run", *options, environment=environment, enter=mounts.enter))
        begun[-1].reach(60.0, mode="sim")
        return begun[-1]

    yield start
    for each in begun:
        each.kill()


def spoil(mounts: OwnMounts, folder: Path, kind: str) -> None:
    if kind == "full":
        mounts.fill(folder)
    else:
        mounts.remount(folder, "ro")


def mend(mounts: OwnMounts, folder: Path, kind: str) -> None:
    if kind == "full":
        mounts.empty(folder)
    else:
        mounts.remount(folder, "rw")


def goes_on(running: Daemon) -> bool:
    """The loop ticks, and replies to a client that commands."""
    with running.client() as client:
        client.call("AcquireLease")
        client.call("ReleaseLease")
        states = client.stream("Monitor", topics=["state"], rate=50.0)
        return bool(next(states)["time"] < next(states)["time"])


def test_shared_memory_that_is_full_keeps_no_daemon_from_its_work(
    mounts: OwnMounts, begin: Callable[[], Daemon], tmp_path: Path
) -> None:
    """Nothing of it lies in /dev/shm: memfds have no file system that a user can fill."""
    for _ in range(2):
        running = begin()
        assert goes_on(running)
        assert running.end() == 0
    mounts.empty(SHM)
    running = begin()
    mounts.fill(SHM)  # while it runs
    out = tmp_path / "one.mcap"
    done = mounts.twindctl("--socket", str(running.sockets), "record", "--seconds", "0.5", "--out", str(out))
    assert done.returncode == 0, done.stderr
    assert len(open_recording(out).time) > 10
    assert mounts.twindctl("--socket", str(running.sockets), "dump").returncode == 0
    assert goes_on(running)
    assert running.end() == 0


@KINDS
def test_the_flight_recorder_says_what_to_do_and_keeps_its_files(
    mounts: OwnMounts, begin: Callable[[], Daemon], state: Path, kind: str
) -> None:
    running = begin()
    words = ("--socket", str(running.sockets), "dump")
    first = Path(mounts.twindctl(*words, "first").stdout.strip())
    kept = mounts.at(first).read_bytes()
    spoil(mounts, state, kind)
    done = mounts.twindctl(*words, "second")
    assert done.returncode == 1
    assert REMEDY[kind] in done.stderr and str(state) in done.stderr
    assert goes_on(running)
    assert REMEDY[kind] in running.log.read_text()
    assert mounts.at(first).read_bytes() == kept
    mend(mounts, state, kind)
    assert mounts.twindctl(*words, "third").returncode == 0
    assert sorted(path.name.split("-")[2] for path in mounts.at(first.parent).iterdir()) == [
        "first.flight",
        "third.flight",
    ]


@KINDS
def test_a_calibration_that_cannot_be_written_stays_as_it_was(
    mounts: OwnMounts, state: Path, kind: str
) -> None:
    for zero in (2048, 2050):
        save_calibration(made(zero), mounts.at(state), "h24")
    path = state / "h24.yaml"
    before = {each.name: each.read_bytes() for each in mounts.at(state).iterdir()}
    spoil(mounts, state, kind)
    words = ("calibrate", "rollback", "1", "--yes", "--robot", "h24", "--calibration", str(path))
    done = mounts.twindctl(*words)
    assert done.returncode == 1
    assert f"{path} cannot be written: {REMEDY[kind]}" in done.stderr
    mend(mounts, state, kind)
    assert {each.name: each.read_bytes() for each in mounts.at(state).iterdir()} == before
    done = mounts.twindctl(*words)
    assert done.returncode == 0, done.stderr
    assert mounts.at(path).read_bytes() == before["h24.0001.yaml"]


@KINDS
def test_a_recording_and_a_spool_that_cannot_be_written_end_with_a_reason_and_the_loop_goes_on(
    mounts: OwnMounts, begin: Callable[[], Daemon], state: Path, kind: str
) -> None:
    running = begin()
    words = ("--socket", str(running.sockets), "record", "--free", "0", "--out")
    first = state / "one.mcap"
    assert mounts.twindctl(*words, str(first), "--seconds", "0.5").returncode == 0
    kept = mounts.at(first).read_bytes()
    spoil(mounts, state, kind)
    done = mounts.twindctl(*words, str(state / "two.mcap"), "--seconds", "5")
    assert done.returncode == 1
    assert REMEDY[kind] in done.stdout + done.stderr
    spool = ("--socket", str(running.sockets), "stream", "--url", "http://127.0.0.1:9/", "--seconds", "5")
    done = mounts.twindctl(*spool, "--spool", str(state / "spool"))
    assert done.returncode == 1
    assert f"{state / 'spool'}: " in done.stderr and "--spool" in done.stderr
    assert "Traceback" not in done.stderr
    assert goes_on(running)
    mend(mounts, state, kind)
    assert mounts.at(first).read_bytes() == kept
    assert open_recording(mounts.at(first)).damage == ""
