"""Lines of styled text, cut and aligned by their width on a terminal.

A style is a word: "" plain, dim, head, title, good, warn, bad, alarm. `picture_renderer` has their colours.
"""

import textwrap
from collections.abc import Iterable, Sequence

from rich.cells import cell_len, set_cell_size

from twind.command_line.verb import harmless

Span = tuple[str, str]  # text, style
Line = tuple[Span, ...]


def line(*spans: str | Span) -> Line:
    """Text is plain where no style is given; characters that are not visible become `?`."""
    return tuple(
        (harmless(span), "") if isinstance(span, str) else (harmless(span[0]), span[1]) for span in spans
    )


def wide(text: str) -> int:
    """Columns of a terminal."""
    return len(text) if text.isascii() else cell_len(text)


def length(of: Line) -> int:
    """Columns of a line."""
    return sum(wide(text) for text, _ in of)


def cut(of: Line, width: int) -> Line:
    """At most so wide; what is cut off ends with `…`."""
    if length(of) <= width:
        return of
    kept: list[Span] = []
    room = width - 1
    for text, style in of:
        if wide(text) > room:
            kept.append((set_cell_size(text, max(0, room)) + "…", style))
            break
        kept.append((text, style))
        room -= wide(text)
    return tuple(kept) if width > 0 else ()


def padded(of: Line, width: int) -> Line:
    """Exactly so wide."""
    short = cut(of, width)
    return (*short, (" " * (width - length(short)), ""))


def right(text: str, width: int) -> str:
    """Text right-aligned to `width`; longer text begins with `…`, since its end is more specific."""
    if wide(text) <= width:
        return " " * (width - wide(text)) + text
    return "…" + text[len(text) - width + 1 :] if width else ""


def align_left(text: str, width: int) -> str:
    """Begins at the column; what is too long ends with `…`."""
    if wide(text) <= width:
        return text + " " * (width - wide(text))
    return set_cell_size(text, width - 1) + "…" if width else ""


def fitting(parts: Iterable[Span], width: int, first: Line = ()) -> Line:
    """Parts with ` · ` between them, as many whole ones as have room behind `first`."""
    shown = list(first)
    room = width - length(first)
    for place, (text, style) in enumerate(part for part in parts if part[0]):
        between = " · " if place else ""
        if wide(between + text) > room and place:
            break
        shown += [(between, "dim"), (harmless(text), style)]
        room -= wide(between + text)
    return cut(tuple(shown), width)


def wrapped(mark: Span, text: str, style: str, width: int) -> list[Line]:
    """A text behind its mark, on as many lines as it needs."""
    indent = " " * wide(mark[0])
    pieces = textwrap.wrap(harmless(text), max(10, width - len(indent))) or [""]
    return [((mark if not place else (indent, "")), (piece, style)) for place, piece in enumerate(pieces)]


def beside(one: Sequence[Line], other: Sequence[Line], width: int, gap: int) -> list[Line]:
    """Two columns; the first is `width` wide."""
    rows = max(len(one), len(other))
    first, second = ([*lines, *[()] * (rows - len(lines))] for lines in (one, other))
    return [(*padded(a, width), (" " * gap, ""), *b) for a, b in zip(first, second, strict=True)]
