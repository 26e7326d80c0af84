"""Rendering of lines: colours where the console has them, signs where it has none, a stable drawing."""

import os
import re
from io import StringIO

import pytest
from rich.color import ColorSystem
from rich.console import Console

from tests.support.picture_messages import troubled
from twind.ctl.dashboard.dashboard_layout import picture
from twind.ctl.dashboard.dashboard_renderer import STYLES, Palette, plain
from twind.ctl.dashboard.styled_lines import line

EVERY = line(*[(name or "plain", name) for name in STYLES])


def colours(text: str) -> list[str]:
    """Every colour that is asked of the terminal."""
    codes = [code for found in re.findall(r"\x1b\[([\d;]*)m", text) for code in found.split(";")]
    return [code for code in codes if code[:1] in "34" and len(code) == 2]


def test_a_terminal_of_colours_gets_them_and_each_line_ends_its_own() -> None:
    for system in (ColorSystem.STANDARD, ColorSystem.EIGHT_BIT, ColorSystem.TRUECOLOR):
        text = Palette(system).text(EVERY)
        assert colours(text)
        assert text.endswith("\x1b[0m")


def test_without_colours_bold_and_reversed_letters_are_left() -> None:
    text = Palette(None).text(EVERY)
    assert not colours(text)
    assert "\x1b[1;7malarm\x1b[0m" in text


@pytest.mark.parametrize(("environment", "some"), [({"NO_COLOR": "1"}, False), ({}, True)])
def test_the_colour_setting_of_the_environment_is_honoured(environment: dict[str, str], some: bool) -> None:
    asked = {**os.environ, "TERM": "xterm-256color", **environment}
    if not environment:
        asked.pop("NO_COLOR", None)
    console = Console(file=StringIO(), force_terminal=True, _environ=asked)
    assert bool(colours(Palette.for_console(console).text(EVERY))) is some


def test_the_words_are_the_same_with_colours_and_without() -> None:
    lines = picture(troubled(), 120, 40)
    for palette in (Palette(None), Palette(ColorSystem.TRUECOLOR)):
        text = "\n".join(palette.text(each) for each in lines)
        assert [row.rstrip() for row in re.sub(r"\x1b\[[\d;]*m", "", text).splitlines()] == plain(
            lines
        ).splitlines()
