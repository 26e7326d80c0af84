"""Rendering of a picture's lines: as terminal text with colours, as plain text."""

from collections.abc import Mapping, Sequence

from rich.color import ColorSystem
from rich.console import Console
from rich.style import Style

from twind.ctl.dashboard.styled_lines import Line

STYLES: Mapping[str, Style] = {
    "": Style(),
    "dim": Style(dim=True),
    "head": Style(bold=True, reverse=True),
    "title": Style(bold=True, color="cyan"),
    "good": Style(color="green"),
    "warn": Style(bold=True, color="yellow"),
    "bad": Style(bold=True, color="red"),
    "alarm": Style(bold=True, color="white", bgcolor="red"),
}
PLAIN_ALARM = Style(bold=True, reverse=True)  # where there are no colours
_SYSTEMS = {
    "standard": ColorSystem.STANDARD,
    "256": ColorSystem.EIGHT_BIT,
    "truecolor": ColorSystem.TRUECOLOR,
    "windows": ColorSystem.WINDOWS,
}


class Palette:
    """Lines as text with the escapes that a terminal understands. None: without any colour."""

    def __init__(self, system: ColorSystem | None) -> None:
        self._system = system or ColorSystem.STANDARD
        self._styles = dict(STYLES)
        if system is None:
            self._styles = {name: style.without_color for name, style in STYLES.items()}
            self._styles["alarm"] = PLAIN_ALARM

    @classmethod
    def for_console(cls, console: Console) -> "Palette":
        """The palette of this console; NO_COLOR is respected."""
        return cls(None if console.no_color else _SYSTEMS.get(console.color_system or ""))

    def text(self, row: Line) -> str:
        """One line; its styles end with it."""
        return "".join(
            self._styles[style].render(text, color_system=self._system) if style else text
            for text, style in row
        )


def plain(lines: Sequence[Line]) -> str:
    """Text alone, a line each."""
    return "\n".join("".join(text for text, _ in row).rstrip() for row in lines)
