"""Lines that the monitor draws, as a terminal shows them."""

import re

import pytest

from twind.ctl.dashboard.terminal_screen import TerminalScreen

WIDTH = 12
TOKEN = re.compile(r"\x1b\[([?\d;]*)([A-Za-z])|(.)")


def shown(written: str, rows: int) -> list[str]:
    """Rows of a terminal that does not wrap: the cursor stays on the last of its `WIDTH` columns."""
    screen = [[" "] * WIDTH for _ in range(rows)]
    row = 0
    column = 0
    for numbers, command, character in TOKEN.findall(written):
        if command == "H":
            row, column = (int(number) - 1 for number in numbers.split(";"))
        elif command == "K":
            screen[row][column:] = [" "] * (WIDTH - column)
        elif character:
            screen[row][column] = character
            column = min(column + 1, WIDTH - 1)
    return ["".join(each) for each in screen]


def test_a_line_of_full_width_keeps_its_last_character(capfd: pytest.CaptureFixture[str]) -> None:
    screen = TerminalScreen()
    screen.draw(["h24    0.1.0", "long line"], (WIDTH, 2))
    screen.draw(["arm    0.1.0", "short"], (WIDTH, 2))
    assert shown(capfd.readouterr().out, 2) == ["arm    0.1.0", "short       "]
