"""The recorded calibration is what the page shows of it; what draws on a terminal leaves what it should."""

import io
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.make_calibration_cast import CAST, PAGE, WHOLE, excerpt, transcript, within
from tests.support.terminal_cast import PROMPT, load, rendered, save, shortened
from twind_calibration.calibrating.sweep_display import SweepDisplay

words = st.text(st.sampled_from("ab █"), max_size=8).map(str.rstrip)


def test_the_page_shows_what_was_recorded() -> None:
    assert within(PAGE.read_text()) == excerpt()


def test_the_recording_goes_the_whole_way() -> None:
    said = transcript()
    for command in ("scan", "sweep", "zero"):
        assert f"{PROMPT}twindctl calibrate {command}\n" in said
    assert not [each for each in WHOLE if each not in said]
    assert CAST.stat().st_size < 400_000
    assert "Traceback" not in load(CAST) and "twindctl: " not in said


@given(st.lists(st.lists(words, min_size=1, max_size=5), min_size=1, max_size=6), st.booleans())
def test_a_board_leaves_the_last_of_what_it_drew(pictures: list[list[str]], printed: bool) -> None:
    out = io.StringIO()
    board = SweepDisplay(out, live=True, rows=24, columns=80)
    for picture in pictures:
        if printed:
            board.print_line("told")
        board.draw(picture)
    lines = rendered(out.getvalue().replace("\n", "\r\n"))
    kept = [each for each in lines if each != "told"][: len(pictures[-1])]
    assert kept == pictures[-1]
    assert lines.count("told") == (len(pictures) if printed else 0)


def test_a_low_terminal_shows_a_note_and_a_non_terminal_gets_no_drawing() -> None:
    out = io.StringIO()
    SweepDisplay(out, live=True, rows=5, columns=40).draw([f"joint {number}" for number in range(9)])
    assert rendered(out.getvalue().replace("\n", "\r\n"))[:3] == [
        "joint 0",
        "joint 1",
        "... 7 more: make the terminal taller",
    ]
    silent = io.StringIO()
    board = SweepDisplay(silent, live=False)
    board.draw(["joint"])
    board.print_line("told")
    assert silent.getvalue() == "told\n"


def test_a_recording_reads_back_and_another_file_is_refused(tmp_path: Path) -> None:
    save(tmp_path / "a.cast", [(0.1, "$ "), (0.5, "l\r\n")], "title")
    assert load(tmp_path / "a.cast") == "$ l\r\n"
    save(tmp_path / "b.cast", [(0.5, "$ "), (0.1, "l\r\n")], "title")
    with pytest.raises(ValueError, match="no asciicast v2"):
        load(tmp_path / "b.cast")


def test_long_answers_are_shortened_in_their_middle() -> None:
    said = ["$ scan", *(f"row {number}" for number in range(9)), "$ end", "bye"]
    assert shortened(said, 4) == [
        "$ scan",
        "row 0",
        "row 1",
        "... 5 more lines",
        "row 7",
        "row 8",
        "$ end",
        "bye",
    ]
