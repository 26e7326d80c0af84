"""Lines for people and for the journal; a blocked standard error blocks nobody."""

import json
import os
import re
import time

import pytest

from twind.front.log import PER_SECOND, WAITING, Log, Writer, at_journal


def lines(*, journal: bool, level: str = "info", said: list[tuple[str, str, dict[str, object]]]) -> list[str]:
    reader, writer = os.pipe()
    log = Log(Writer(writer), level, journal=journal)
    for place, (severity, event, fields) in enumerate(said):
        log.say(severity, event, float(place), **fields)
    log.close()
    os.close(writer)
    with os.fdopen(reader) as text:
        return text.read().splitlines()


def test_the_journal_gets_a_level_and_json() -> None:
    (line,) = lines(journal=True, said=[("warning", "LATE", {"message": "slow", "ms": 1.5})])
    assert line.startswith("<4>")
    assert json.loads(line[3:]) == {"event": "LATE", "level": "warning", "message": "slow", "ms": 1.5}


def test_people_get_one_readable_line() -> None:
    (line,) = lines(
        journal=False, said=[("info", "ARMED", {"message": "all joints", "holder": "uid 0, pid 1"})]
    )
    assert line[8:] == " info    ARMED: all joints holder='uid 0, pid 1'"


def test_below_the_level_nothing_is_said() -> None:
    assert lines(journal=True, level="warning", said=[("info", "A", {}), ("error", "B", {})]) == [
        '<3>{"event": "B", "level": "error"}'
    ]


@pytest.mark.parametrize("journal", [True, False])
def test_nothing_a_client_says_breaks_a_line_or_steers_a_terminal(journal: bool) -> None:
    evil = "x\n<0>forged\x1b[2J\x07\u202e"
    (line,) = lines(journal=journal, said=[("info", "E", {"message": evil, "reason": evil})])
    assert line.isprintable()


def test_a_flood_is_cut_and_counted() -> None:
    reader, writer = os.pipe()
    log = Log(Writer(writer), "info", journal=True)
    for _ in range(PER_SECOND + 5):
        log.say("info", "SAME", 10.0)
    log.say("info", "LATER", 12.0)
    log.close()
    os.close(writer)
    with os.fdopen(reader) as text:
        said = text.read().splitlines()
    assert len(said) == PER_SECOND + 1
    assert json.loads(said[-1][3:])["lines_left_out"] == 5


@pytest.mark.realtime
def test_a_standard_error_that_nobody_reads_blocks_nobody_and_the_loss_is_counted() -> None:
    reader, writer = os.pipe()
    sink = Writer(writer)
    began = time.monotonic()
    for _ in range(3 * WAITING):
        sink.put("x" * 200)
    assert time.monotonic() - began < 5.0
    assert sink.dropped >= WAITING
    text = b""
    while sum(map(int, re.findall(rb"(\d+) lines lost", text))) < sink.dropped:
        text += os.read(reader, 65536)
    sink.close()
    os.close(writer)
    os.close(reader)
    assert sum(map(int, re.findall(rb"(\d+) lines lost", text))) == sink.dropped


def test_the_journal_is_known_by_its_inode(monkeypatch: pytest.MonkeyPatch) -> None:
    reader, writer = os.pipe()
    there = os.fstat(writer)
    monkeypatch.setenv("JOURNAL_STREAM", f"{there.st_dev}:{there.st_ino}")
    assert at_journal(writer)
    monkeypatch.setenv("JOURNAL_STREAM", f"{there.st_dev}:{there.st_ino + 1}")
    assert not at_journal(writer)
    monkeypatch.delenv("JOURNAL_STREAM")
    assert not at_journal(writer)
    os.close(reader)
    os.close(writer)
    assert not at_journal(writer)
