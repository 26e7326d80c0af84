"""Output of verbs: text from files and daemons moves no cursor."""

import argparse

import pytest

from twind.command_line.verb import complain, harmless, show
from twind.ctl.monitor_command import WATCH

EVIL = "a\x1b[2J\x9b31m\rb"
TOLD = "a?[2J?31m?b"


def test_an_invisible_character_becomes_a_question_mark() -> None:
    assert harmless("a\x1b[31m\n\x07\u200eb µ°") == "a?[31m???b µ°"


def test_a_result_keeps_its_lines_and_loses_its_escapes(capsys: pytest.CaptureFixture[str]) -> None:
    show(argparse.Namespace(json=False), {}, f"{EVIL}\n  second")
    assert capsys.readouterr().out == f"{TOLD}\n  second\n"


def test_an_error_names_what_was_wrong_without_its_escapes(capsys: pytest.CaptureFixture[str]) -> None:
    complain(argparse.Namespace(json=False), ValueError("no joint 'a\x1b[2J'\nno joint b"))
    assert capsys.readouterr().err == "twindctl: no joint 'a?[2J'\ntwindctl: no joint b\n"


def test_an_event_is_one_line_whatever_its_text(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Observer:
        def __enter__(self) -> "Observer":
            return self

        def __exit__(self, *_: object) -> None: ...

        def stream(self, _method: str, **_asked: object) -> list[dict[str, object]]:
            event = {
                "time": 1.0,
                "level": "info",
                "code": "NOTE",
                "message": f"{EVIL}\n2.000",
                "findings": [],
            }
            return [{"topic": "events", "dropped": 0, "event": event}]

    monkeypatch.setattr("twind.ctl.monitor_command.observer", lambda options: Observer())
    assert WATCH.run(argparse.Namespace(topic="events", count=1, json=False)) == 0
    assert capsys.readouterr().out == f"1.000 info    NOTE: {TOLD}?2.000\n"
