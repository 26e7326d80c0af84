"""The link of the fail-safe: events as lines on a descriptor, and in the recorder; nothing else."""

import os
from pathlib import Path
from typing import Any

import pytest

from tests.support.loop_stand_in import tick
from twind import link
from twind.flight import EntryKind
from twind.loop.procedures.failsafe import HeadlessLink


def test_an_event_is_one_line_and_other_messages_are_dropped(tmp_path: Path) -> None:
    said = (tmp_path / "said").open("w+b", buffering=0)
    with said:
        aloud = HeadlessLink(said.fileno())
        aloud.event(link.Event(time=0.0, sequence=1, level="error", code="CODE", message="über", findings=[]))
        aloud.reply(link.Reply(ticket=1, parameters={}))
        aloud.flush()
        said.seek(0)
        assert said.read().decode() == "error CODE: über\n"
    assert aloud.commands(0.0) == []


def test_an_event_is_printed_before_it_is_recorded_and_no_recorder_stops_the_fail_safe(
    tmp_path: Path,
) -> None:
    """Words that have no encoding: a name of a port, say."""
    told: list[tuple[str, Any]] = []
    with (tmp_path / "said").open("w+b", buffering=0) as said:

        def record(kind: Any, data: bytes) -> None:
            told.append((os.pread(said.fileno(), 1000, 0).decode(), link.decode_news(data)))

        aloud = HeadlessLink(said.fileno(), record)
        odd = link.Event(time=0.0, sequence=1, level="error", code="CODE", message="tty\udc80", findings=[])
        aloud.event(odd)
        assert told == []
        plain = link.Event(time=0.0, sequence=2, level="error", code="CODE", message="tty", findings=[])
        aloud.event(plain)
        said.seek(0)
        assert said.read().decode() == "error CODE: tty\\udc80\nerror CODE: tty\n"
        assert told == [("error CODE: tty\\udc80\nerror CODE: tty\n", plain)]  # told, then written down


def test_without_a_recorder_no_event_is_encoded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def none(_news: Any) -> bytes:
        raise AssertionError("encoded for nobody")

    monkeypatch.setattr(link, "encode", none)
    with (tmp_path / "said").open("w+b", buffering=0) as said:
        aloud = HeadlessLink(said.fileno())
        aloud.event(link.Event(time=0.0, sequence=1, level="info", code="CODE", message="", findings=[]))
        assert os.pread(said.fileno(), 100, 0) == b"info CODE: \n"


def test_states_are_recorded_and_events_numbered(tmp_path: Path) -> None:
    kept: list[tuple[EntryKind, bytes]] = []

    def record(kind: EntryKind, data: bytes) -> None:
        kept.append((kind, data))

    with (tmp_path / "said").open("w+b", buffering=0) as said:
        aloud = HeadlessLink(said.fileno(), record)
        verdict = link.VerdictReport(time=1.0, sequence=1, id="a", verdict={})
        state = tick(now=1.0, sequence=1)
        aloud.event(verdict)
        aloud.state(state)
        assert os.pread(said.fileno(), 100, 0) == b""
        assert kept == [(EntryKind.NEWS, link.encode(verdict)), (EntryKind.NEWS, link.encode(state))]
        assert [aloud.sequence() for _ in range(3)] == [1, 2, 3]


def test_a_briefing_is_closed_and_calls_find_no_front() -> None:
    read, write = os.pipe()
    try:
        aloud = HeadlessLink(write)
        assert (aloud.dropped, aloud.lost, aloud.no_front) == (0, False, "")
        aloud.set_briefing(os.dup(read))
        briefing = os.dup(read)
        aloud.set_briefing(briefing)
        with pytest.raises(OSError, match="Bad file descriptor"):
            os.fstat(briefing)
    finally:
        os.close(read)
        os.close(write)
