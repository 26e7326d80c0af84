"""Closed standard streams, the journal's levels, lines that nobody waits for."""

import os
import signal
from collections.abc import Iterator
from contextlib import suppress

import pytest

from twind.standard_streams import at_journal, lines, write_line


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
    write_line(pipe[1], "warning", "über")
    assert os.read(pipe[0], 100).decode() == "<4>über\n"


def test_a_reader_that_is_too_slow_is_not_waited_for(pipe: tuple[int, int]) -> None:
    for _ in range(1000):  # 2 MB: a pipe takes 64 kB
        write_line(pipe[1], "info", "x" * 2000)
    assert len(os.read(pipe[0], 1 << 20)) > 4096


def test_a_log_without_a_reader_raises_no_error(
    pipe: tuple[int, int], capfd: pytest.CaptureFixture[str]
) -> None:
    os.close(pipe[0])
    old = signal.signal(signal.SIGPIPE, signal.SIG_IGN)
    write_line(pipe[1], "info", "gone")
    signal.signal(signal.SIGPIPE, old)
    os.close(pipe[1])
    write_line(pipe[1], "info", "closed")
    assert capfd.readouterr() == ("", "")


# ------------------------------------------------------------------------------------- the daemon
