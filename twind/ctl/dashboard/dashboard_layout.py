"""A picture: which blocks a page has, and what is dropped where the terminal is small. Pure.

The header and what is wrong come first on every page. Then, in the page's order, each block of its first tier
gets its least while there is room, and grows in the same order; the second tier has the rest. Who has no room
is named in the last line.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from twind.ctl.dashboard.dashboard_blocks import (
    DashboardBlock,
    events,
    header,
    last_refusals,
    recorder,
    refusals,
    summary,
    trouble,
)
from twind.ctl.dashboard.dashboard_state import DashboardState
from twind.ctl.dashboard.joint_table import joints
from twind.ctl.dashboard.styled_lines import Line, beside, cut, fitting, line
from twind.ctl.dashboard.timing_blocks import buses, hops, lateness

# columns from which there are two sides; of the left one; between them
WIDE = 185
LEFT = 110
GAP = 3
Make = Callable[[DashboardState, int], DashboardBlock]
# Pages and sides are tiers of blocks: the second tier has what the first one leaves.
PAGES: Mapping[str, Sequence[Sequence[Make]]] = {
    "all": ((summary, buses, joints, last_refusals), (hops, lateness, recorder, events)),
    "joints": ((joints,),),
    "timing": ((summary, buses, hops, lateness),),
    "events": ((refusals, events, recorder),),
}
SIDES: Sequence[Sequence[Sequence[Make]]] = (
    ((joints, last_refusals), (events,)),
    ((summary, buses), (hops, lateness, recorder)),
)  # of page "all" where it is wide


@dataclass(frozen=True, slots=True)
class PageSelection:
    """Page, scroll position and freeze, as selected by keys."""

    page: str = "all"
    offset: int = 0  # rows that the joints are moved by
    frozen_since: float | None = None  # s, monotonic


def picture(
    view: DashboardState, width: int, height: int | None, shown: PageSelection | None = None, now: float = 0.0
) -> list[Line]:
    """Lines at most `width` wide, at most `height` of them (None: all that there are, without keys)."""
    chosen = shown or PageSelection()
    top = [header(view, width)]
    wrong = trouble(view, width)
    if height is None:
        whole = [make(view, width) for tier in PAGES[chosen.page] for make in tier]
        rows = [each for block in whole for each in block.shown(block.full_height)]
        return [*top, *wrong.shown(wrong.full_height), *rows]
    top += wrong.shown(min(wrong.full_height, max(wrong.least, (height - 2) // 2)))
    room = height - len(top) - 1
    if width >= WIDE and chosen.page == "all":
        one, left_out = _packed(SIDES[0], view, LEFT, room, chosen.offset)
        other, right_out = _packed(SIDES[1], view, width - LEFT - GAP, room, chosen.offset)
        body = beside(one, other, LEFT, GAP)
        hidden = [*left_out, *right_out]
    else:
        body, hidden = _packed(PAGES[chosen.page], view, width, room, chosen.offset)
    body += [()] * (room - len(body))
    lines = [*top, *body, _keys(chosen, hidden, width, now)]
    return [cut(each, width) for each in lines[:height]]


def _packed(
    tiers: Sequence[Sequence[Make]], view: DashboardState, width: int, room: int, offset: int
) -> tuple[list[Line], list[str]]:
    """Lines of what there is room for, and the names of what there is none for."""
    lines: list[Line] = []
    hidden: list[str] = []
    for tier in tiers:
        blocks = [block for make in tier if (block := make(view, width)).full_height]
        given = _shared(blocks, room - len(lines))
        for block, count in zip(blocks, given, strict=True):
            lines += block.shown(count, offset)
        hidden += [block.name for block, count in zip(blocks, given, strict=True) if not count]
    return lines, hidden


def _shared(blocks: Sequence[DashboardBlock], room: int) -> list[int]:
    """Lines of each block: in their order the least of each, as far as there is room, then more; 0: none."""
    given: list[int] = []
    for block in blocks:
        given.append(block.least if block.least <= room else 0)
        room -= given[-1]
    for place, block in enumerate(blocks):
        if given[place]:
            more = min(room, block.full_height - given[place])
            given[place] = given[place] + more
            room = room - more
    return given


def _keys(chosen: PageSelection, hidden: Sequence[str], width: int, now: float) -> Line:
    """The last line: blocks without room, and the keys."""
    start: Line = ()
    if chosen.frozen_since is not None:
        start = line((f" FROZEN for {max(0.0, now - chosen.frozen_since):.0f} s ", "alarm"), " ")
    parts = [(f"no room for {', '.join(hidden)}: Tab shows more pages", "warn")] if hidden else []
    parts += [("q ends", "dim"), ("space freezes" if not start else "space goes on", "dim")]
    parts += [(f"Tab: page {chosen.page} of {', '.join(PAGES)}", "dim")]
    return fitting(parts, width, start)
