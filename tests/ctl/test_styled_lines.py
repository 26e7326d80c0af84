"""Text by the columns that it takes on a terminal."""

import pytest

from twind.ctl.dashboard.dashboard_renderer import plain
from twind.ctl.dashboard.styled_lines import (
    align_left,
    beside,
    cut,
    fitting,
    length,
    line,
    padded,
    right,
    wrapped,
)

WIDE = "腕一"  # two columns each


@pytest.mark.parametrize("width", range(9))
def test_a_cut_text_ends_with_an_ellipsis_and_fits_its_width(width: int) -> None:
    for text in ("abcdefgh", WIDE * 3, f"a{WIDE}b{WIDE}"):
        shown = cut(line("x", (text, "bad")), width)
        assert length(shown) <= width
        if width:
            assert plain([shown]).endswith("…")
    assert cut(line("abc"), 3) == line("abc")


@pytest.mark.parametrize("width", range(9))
def test_a_cell_has_exactly_the_requested_width(width: int) -> None:
    for text in ("", "abcd", "abcdefghijk", WIDE):
        assert length(padded(line(text), width)) == width
        assert length(line(align_left(text, width))) == width or text == WIDE
    assert right("12345", 3) == "…45"
    assert align_left("12345", 3) == "12…"


def test_parts_are_shown_whole_or_not_at_all_but_the_first() -> None:
    parts = [("one", ""), ("", ""), ("two", "warn"), ("three", "")]
    assert plain([fitting(parts, 40, line("l "))]) == "l one · two · three"
    assert plain([fitting(parts, 14, line("l "))]) == "l one · two"
    assert plain([fitting([("a long word", "")], 8)]) == "a long …"


def test_a_long_text_goes_on_below_its_first_word() -> None:
    rows = wrapped(("! ", "bad"), "one two three four", "", 12)
    assert plain(rows).splitlines() == ["! one two", "  three four"]


def test_two_columns_of_different_length_stand_beside_each_other() -> None:
    both = beside([line("a"), line("b")], [line("c")], 4, 2)
    assert plain(both).splitlines() == ["a     c", "b"]
