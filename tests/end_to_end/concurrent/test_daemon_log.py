"""Lines for people and for the journal; a blocked standard error blocks nobody."""

import json
import os
import re
import socket
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from twind.front.daemon_log import PER_SECOND, WAITING, DaemonLog, LogWriter
from twind.front.event_logger import EventLogger
from twind.front.joint_naming import JointNames
from twind.front.systemd_journal import datagram
from twind.link import Event
from twind.robot.finding import Finding, ReasonCode


def lines(
    *, journal: bool, level: str = "info", entries: list[tuple[str, str, dict[str, object]]]
) -> list[str]:
    reader, writer = os.pipe()
    log = DaemonLog(LogWriter(writer), level, journal=journal)
    for place, (severity, event, fields) in enumerate(entries):
        log.write(severity, event, float(place), **fields)
    log.close()
    os.close(writer)
    with os.fdopen(reader) as text:
        return text.read().splitlines()


def test_the_journal_gets_a_level_and_json() -> None:
    (line,) = lines(journal=True, entries=[("warning", "LATE", {"message": "slow", "ms": 1.5})])
    assert line.startswith("<4>")
    assert json.loads(line[3:]) == {"event": "LATE", "level": "warning", "message": "slow", "ms": 1.5}


def test_a_log_event_is_one_readable_line() -> None:
    (line,) = lines(
        journal=False, entries=[("info", "ARMED", {"message": "all joints", "holder": "uid 0, pid 1"})]
    )
    assert line[8:] == " info    ARMED: all joints holder='uid 0, pid 1'"


@pytest.mark.parametrize("journal", [True, False])
def test_client_text_neither_breaks_a_log_line_nor_controls_a_terminal(journal: bool) -> None:
    evil = "x\n<0>forged\x1b[2J\x07\u202e"
    (line,) = lines(journal=journal, entries=[("info", "E", {"message": evil, "reason": evil})])
    assert line.isprintable()


def test_a_flood_is_cut_and_counted() -> None:
    reader, writer = os.pipe()
    log = DaemonLog(LogWriter(writer), "info", journal=True)
    for _ in range(PER_SECOND + 5):
        log.write("info", "SAME", 10.0)
    log.write("info", "LATER", 12.0)
    log.close()
    os.close(writer)
    with os.fdopen(reader) as text:
        said = text.read().splitlines()
    assert len(said) == PER_SECOND + 1
    assert json.loads(said[-1][3:])["lines_left_out"] == 5


def test_a_blocked_standard_error_blocks_no_thread_and_lost_lines_are_counted() -> None:
    reader, writer = os.pipe()
    sink = LogWriter(writer)
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


# ------------------------------------------------------------------------------- the journal


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[socket.socket]:
    """A stand-in for the journal's socket: entries arrive as datagrams."""
    receiver = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    receiver.bind(str(tmp_path / "journal"))
    receiver.settimeout(5.0)
    yield receiver
    receiver.close()


def entry(data: bytes) -> dict[str, str]:
    """An entry as the native protocol has it, by a reader of our own."""
    found = {}
    while data:
        name, _, data = data.partition(b"\n")
        if b"=" in name:
            name, _, value = name.partition(b"=")
        else:
            size = int.from_bytes(data[:8], "little")
            value = data[8 : 8 + size]
            data = data[8 + size + 1 :]
        found[name.decode()] = value.decode()
    return found


def test_an_entry_has_fields_that_can_be_searched_for(tmp_path: Path, journal: socket.socket) -> None:
    log = DaemonLog(
        LogWriter(os.open(os.devnull, os.O_WRONLY), str(tmp_path / "journal")), "info", journal=True
    )
    event = Event(
        time=1.0,
        sequence=1,
        level="error",
        code="OUT_OF_LIMIT",
        message="bring it back",
        findings=[Finding(ReasonCode.OUT_OF_LIMIT, 2, value=1.25, bound=1.0, message="bring it back")],
    )
    EventLogger(log).event(event, JointNames(["a", "b", "l_knee"]), ["arms", "arms", "legs"], "armed")
    log.close()
    said = entry(journal.recv(65536))
    assert said == {
        "SYSLOG_IDENTIFIER": "twind",
        "MESSAGE": "OUT_OF_LIMIT: l_knee: position 1.25 rad, bound 1 rad; bring it back",
        "PRIORITY": "3",
        "TWIND_CODE": "OUT_OF_LIMIT",
        "TWIND_STATE": "armed",
        "TWIND_JOINT": "l_knee",
        "TWIND_BUS": "legs",
        "TWIND_VALUE": "1.25",
        "TWIND_BOUND": "1.0",
    }


def test_log_text_forges_no_journal_field() -> None:
    fields = {
        "MESSAGE": "a\nPRIORITY=0\n",
        "bad name": 1,
        "_HIDDEN": 1,
        "": 1,
        "lower": 1,
        "NONE": None,
        "É": 1,
    }
    found = entry(datagram(fields))
    assert found == {"SYSLOG_IDENTIFIER": "twind", "MESSAGE": "a\nPRIORITY=0\n"}


def test_a_journal_that_is_gone_or_full_does_not_lose_what_standard_error_takes(
    tmp_path: Path, journal: socket.socket
) -> None:
    reader, writer = os.pipe()
    log = DaemonLog(LogWriter(writer, str(tmp_path / "journal")), "info", journal=True)
    log.write("info", "TAKEN", 1.0)
    assert entry(journal.recv(65536))["TWIND_CODE"] == "TAKEN"
    journal.close()
    (tmp_path / "journal").unlink()
    log.write("warning", "LEFT", 2.0, message="m")
    log.close()
    os.close(writer)
    with os.fdopen(reader) as text:
        assert text.read() == '<4>{"message": "m", "event": "LEFT", "level": "warning"}\n'


def test_the_level_may_change() -> None:
    reader, writer = os.pipe()
    log = DaemonLog(LogWriter(writer), "warning", journal=True)
    log.write("info", "A", 1.0)
    log.level("debug")
    log.write("debug", "B", 2.0)
    log.level("error")
    log.write("warning", "C", 3.0)
    log.close()
    os.close(writer)
    with os.fdopen(reader) as text:
        assert [json.loads(line[3:])["event"] for line in text] == ["B"]


# ------------------------------------------------------------------------------- nobody takes lines


def test_lines_lost_to_a_full_disk_are_counted_and_reported_when_there_is_room(tmp_path: Path) -> None:
    file = tmp_path / "log"
    full = os.open("/dev/full", os.O_WRONLY)
    fd = os.dup(full)
    sink = LogWriter(fd)
    for number in range(7):
        sink.put(f"line {number}")
    deadline = time.monotonic() + 5.0
    while sink.failed < 7 and time.monotonic() < deadline:
        time.sleep(0.005)
    assert sink.failed == 7
    room = os.open(file, os.O_WRONLY | os.O_CREAT, 0o600)
    os.dup2(room, fd)
    sink.put("there is room")
    sink.close()
    first, second = file.read_text().splitlines()
    assert first.startswith("... 7 lines lost")
    assert second == "there is room"
    for each in (full, fd, room):
        os.close(each)
