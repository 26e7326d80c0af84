"""Closed standard streams, the journal's levels, lines that nobody waits for."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
from processes import until

from twind.client import Client, ClientError
from twind.standard_streams import at_journal, lines, tell


@pytest.fixture
def pipe() -> Iterator[tuple[int, int]]:
    ends = os.pipe()
    yield ends
    for fd in ends:
        with suppress(OSError):
            os.close(fd)


def as_journal(monkeypatch: pytest.MonkeyPatch, fd: int) -> None:
    there = os.fstat(fd)
    monkeypatch.setenv("JOURNAL_STREAM", f"{there.st_dev}:{there.st_ino}")


def test_the_journal_is_known_by_its_inode(pipe: tuple[int, int], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("JOURNAL_STREAM", raising=False)
    assert not at_journal(pipe[1])
    as_journal(monkeypatch, pipe[1])
    assert at_journal(pipe[1])
    with open(os.devnull, "wb") as other:
        assert not at_journal(other.fileno())
    os.close(pipe[1])
    assert not at_journal(pipe[1])


def test_each_line_for_the_journal_carries_its_level(
    pipe: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("JOURNAL_STREAM", raising=False)
    assert lines(pipe[1], "error", "one\ntwo") == "one\ntwo"
    as_journal(monkeypatch, pipe[1])
    assert lines(pipe[1], "error", "one\ntwo") == "<3>one\n<3>two"
    tell(pipe[1], "warning", "über")
    assert os.read(pipe[0], 100).decode() == "<4>über\n"


def test_a_reader_that_is_too_slow_is_not_waited_for(pipe: tuple[int, int]) -> None:
    for _ in range(1000):  # 2 MB: a pipe takes 64 kB
        tell(pipe[1], "info", "x" * 2000)
    assert len(os.read(pipe[0], 1 << 20)) > 4096


def test_nobody_reading_at_all_is_no_failure(
    pipe: tuple[int, int], capfd: pytest.CaptureFixture[str]
) -> None:
    os.close(pipe[0])
    old = signal.signal(signal.SIGPIPE, signal.SIG_IGN)
    tell(pipe[1], "info", "gone")
    signal.signal(signal.SIGPIPE, old)
    os.close(pipe[1])
    tell(pipe[1], "info", "closed")
    assert capfd.readouterr() == ("", "")


# ------------------------------------------------------------------------------------- the daemon


@contextmanager
def without_streams(folder: Path, *closed: int) -> Iterator[subprocess.Popen[bytes]]:
    """A simulating daemon that was started with these closed."""
    shut = " ".join(f"{fd}{'<' if fd == 0 else '>'}&-" for fd in closed)
    command = f'exec "$0" -m twind.cli --mode sim --socket "$1" {shut}'
    with open(os.devnull, "r+b") as kept:
        daemon = subprocess.Popen(
            ["sh", "-c", command, sys.executable, str(folder)], stdin=kept, stdout=kept, stderr=kept
        )
        try:
            yield daemon
        finally:
            if daemon.poll() is None:
                daemon.kill()
            daemon.wait(10)


def answers(folder: Path) -> bool:
    with suppress(ClientError), Client(str(folder)) as client:
        return bool(client.call("GetStatus")["status"]["mode"] == "sim")
    return False


@pytest.mark.realtime
@pytest.mark.parametrize("closed", [(0, 1, 2), (2,)])
def test_a_daemon_without_standard_streams_runs_and_nothing_else_gets_their_numbers(
    tmp_path: Path, closed: tuple[int, ...]
) -> None:
    with without_streams(tmp_path, *closed) as daemon:
        until(lambda: answers(tmp_path), 20.0, "an answer")
        children = Path(f"/proc/{daemon.pid}/task/{daemon.pid}/children").read_text().split()
        for pid in (str(daemon.pid), *children):
            for fd in (0, 1, 2):
                assert os.readlink(f"/proc/{pid}/fd/{fd}") == os.devnull, (pid, fd)
        daemon.terminate()
        assert daemon.wait(20) == 0


@pytest.mark.realtime
@pytest.mark.parametrize("reader", ["gone", "asleep"])
def test_whoever_reads_standard_error_may_go_or_sleep(tmp_path: Path, reader: str) -> None:
    inner, outer = os.pipe()
    if reader == "asleep":
        os.set_blocking(outer, False)
        with suppress(BlockingIOError):
            while True:
                os.write(outer, b"x" * 65536)
        os.set_blocking(outer, True)
    command = [sys.executable, "-m", "twind.cli", "--mode", "sim", "--socket", str(tmp_path)]
    daemon = subprocess.Popen(command, stdin=subprocess.DEVNULL, stderr=outer)
    os.close(outer)
    if reader == "gone":
        os.close(inner)
    try:
        until(lambda: answers(tmp_path), 20.0, "an answer")
        with Client(str(tmp_path)) as client:
            for _ in range(20):  # each an event
                client.call("AcquireLease")
                client.call("ReleaseLease")
        daemon.terminate()
        assert daemon.wait(20) == 0
    finally:
        if daemon.poll() is None:
            daemon.kill()
        daemon.wait(10)
        with suppress(OSError):
            os.close(inner)
