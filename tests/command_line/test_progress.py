"""Progress of long work: a line on a terminal, nothing anywhere else, and nothing left of it."""

import argparse
import fcntl
import io
import os
import pty
import struct
import termios

import pytest

from twind.command_line.progress import BAR, ProgressLine


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


class TimedProgress:
    """A progress under a clock that the test moves."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *, json: bool = False, **how: float) -> None:
        monkeypatch.setenv("TERM", "xterm")
        self.out = Terminal()
        self.time = 100.0
        options = argparse.Namespace(json=json)
        self.progress = ProgressLine(options, "scan", out=self.out, now=lambda: self.time, **how)

    def after(self, seconds: float, text: str, share: float | None = None) -> str:
        """Text that is written for an update `seconds` later."""
        self.time += seconds
        place = self.out.tell()
        self.progress.update(text, share)
        return self.out.getvalue()[place:]


def test_a_progress_line_shows_share_elapsed_and_remaining_time(monkeypatch: pytest.MonkeyPatch) -> None:
    timed = TimedProgress(monkeypatch)
    bar = "━" * (BAR // 4) + "─" * (BAR - BAR // 4)
    assert timed.after(1.0, "57600 baud", 0.25) == f"\rscan  {bar}  25%  0:01  57600 baud\x1b[K"
    assert timed.after(2.0, "1 Mbaud", 0.25) == f"\rscan  {bar}  25%  0:03, about 0:09 left  1 Mbaud\x1b[K"


def test_a_step_with_escapes_in_its_name_moves_no_cursor(monkeypatch: pytest.MonkeyPatch) -> None:
    assert TimedProgress(monkeypatch).after(0.0, "bus\x1b[2J\n").endswith("bus?[2J?\x1b[K")


def test_an_unknown_share_is_not_estimated(monkeypatch: pytest.MonkeyPatch) -> None:
    assert TimedProgress(monkeypatch).after(65.0, "asking") == "\rscan  1:05  asking\x1b[K"
    assert "25%" in TimedProgress(monkeypatch, seconds=40.0).after(10.0, "asking")


@pytest.mark.parametrize(("share", "shown"), [(-1.0, "   0%"), (7.0, " 100%")])
def test_a_share_beyond_the_whole_breaks_no_bar(
    monkeypatch: pytest.MonkeyPatch, share: float, shown: str
) -> None:
    line = TimedProgress(monkeypatch).after(0.0, "", share)
    assert shown in line
    assert line.count("━") + line.count("─") == BAR


def test_a_step_is_drawn_ten_times_a_second_at_most_and_a_new_one_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    timed = TimedProgress(monkeypatch)
    assert timed.after(0.0, "one")
    assert timed.after(0.05, "one", 0.9) == ""
    assert "two" in timed.after(0.0, "two")
    assert "two" in timed.after(0.15, "two")
    timed.progress.clear()
    assert timed.out.getvalue().endswith("\r\x1b[K")
    assert "two" in timed.after(0.0, "two")


def test_clearing_what_is_not_shown_writes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    timed = TimedProgress(monkeypatch)
    with timed.progress as progress:
        progress.clear()
    assert timed.out.getvalue() == ""


def test_an_interrupted_work_erases_its_progress_line(monkeypatch: pytest.MonkeyPatch) -> None:
    timed = TimedProgress(monkeypatch)

    def interrupted() -> None:
        with timed.progress as progress:
            progress.update("half", 0.5)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert timed.out.getvalue().endswith("\r\x1b[K")
    assert "\x1b[?" not in timed.out.getvalue()  # neither a hidden cursor nor another screen


def test_in_a_pipe_with_json_and_on_a_terminal_that_moves_no_cursor_it_is_silent(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert TimedProgress(monkeypatch, json=True).after(0.0, "x", 0.5) == ""
    pipe = io.StringIO()
    ProgressLine(argparse.Namespace(json=False), "scan", out=pipe).update("x", 0.5)
    assert pipe.getvalue() == ""
    monkeypatch.setenv("TERM", "dumb")
    terminal = Terminal()
    ProgressLine(argparse.Namespace(json=False), "scan", out=terminal).update("x", 0.5)
    assert terminal.getvalue() == ""


def test_a_line_is_never_wider_than_the_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm")
    ours, theirs = pty.openpty()
    with open(theirs, "w", encoding="utf-8") as out:
        fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 40, 0, 0))
        ProgressLine(argparse.Namespace(json=False), "scan", out=out).update("a" * 100, 0.5)
        shown = os.read(ours, 4096).decode()
    os.close(ours)
    assert len(shown.strip("\r").removesuffix("\x1b[K")) == 39


def test_progress_advances_as_items_are_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    timed = TimedProgress(monkeypatch)
    taken = []
    for thing in timed.progress.each("abcd", "letter {}".format):
        taken.append(thing)
        timed.time += 1.0
    assert taken == list("abcd")
    shown = timed.out.getvalue().split("\r")[1:]
    assert [line.split()[2] for line in shown] == ["0%", "25%", "50%", "75%"]
    assert [line.split()[-1] for line in shown] == [f"{letter}\x1b[K" for letter in "abcd"]
