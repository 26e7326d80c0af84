"""Rendering of a picture's lines: for a rich console, as terminal text, as plain text, as SVG."""

from collections.abc import Mapping, Sequence
from io import StringIO

from rich.color import ColorSystem
from rich.console import Console, ConsoleOptions, RenderResult
from rich.segment import Segment
from rich.style import Style

from twind.ctl.picture.picture_layout import PageSelection, picture
from twind.ctl.picture.picture_state import PictureState
from twind.ctl.picture.styled_lines import Line

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


class RichPicture:
    """The lines as something that a rich console prints."""

    def __init__(self, lines: Sequence[Line]) -> None:
        self.lines = lines

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        for row in self.lines:
            for text, style in row:
                yield Segment(text, STYLES[style])
            yield Segment.line()


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


def svg(
    view: PictureState,
    *,
    title: str,
    width: int = 120,
    height: int | None = 40,
    shown: PageSelection | None = None,
) -> str:
    """The picture as a drawing of a terminal, the same for the same view."""
    console = Console(
        record=True, width=width, file=StringIO(), force_terminal=True, color_system="truecolor", _environ={}
    )
    console.print(RichPicture(picture(view, width, height, shown, view.now)), end="")
    return console.export_svg(title=title, unique_id="twind-monitor")
