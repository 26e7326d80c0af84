"""A recording as a page of A4, by matplotlib without a display. `plot_lines` works out what is drawn."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import ScalarFormatter

from twind.new_file import open_new
from twind.observe.plotting.plot_lines import COLOURS, PlotLine, PlotMark, gap_shares, line, marks, worst
from twind.observe.recording.recording_columns import Floats, RobotRecording

# A4 upright in inches; dots an inch: 1075 × 1519
PAGE = (8.27, 11.69)
DOTS = 130
GREY, BAD, NOTABLE, EPISODE = "0.80", "#d55e00", "#0072b2", "#f0e442"
NAMED = 14  # marks that get their words; more would lie on each other
HOPS = (
    "total",
    "request",
    "reply",
    "state",
    "twin",
    "command",
    "moved",
)  # in this order where they are known

Window = tuple[float, float]  # s


@dataclass(frozen=True, slots=True)
class PlotContext:
    """Input of every panel: the recording, its joints in colour, and the drawn time window."""

    recording: RobotRecording
    colours: Mapping[str, str]  # joint -> colour
    window: Window

    def columns(self, time: Floats, values: Floats) -> list[tuple[str, PlotLine]]:
        """A line for each joint of (m, n) values, those in colour last: on top."""
        joints = self.recording.joints
        order = sorted(range(len(joints)), key=lambda place: joints[place] in self.colours)
        found = [(joints[place], line(time, values[:, place], self.window)) for place in order]
        return [(name, each) for name, each in found if each.time.size]


def figure(recording: RobotRecording, joints: Sequence[str] | None, window: Window) -> Figure:
    """The page. `joints`: those in colour, None: the worst followed; `window` in s since the start.

    Raises ValueError: no such joint, too many of them, or nothing is known in that stretch.
    """
    chosen = worst(recording, window) if joints is None else _joints_with_data(recording, joints)
    begin = max(window[0], 0.0)
    end = min(window[1], _last(recording))
    sheet = PlotContext(recording, dict(zip(chosen, COLOURS, strict=False)), (begin, end))
    panels = [(draw, height) for draw, height, known in PANELS if known(sheet)]
    if not panels:
        raise ValueError(
            f"nothing is known between {begin:.3f} and {end:.3f} s; it has {_last(recording):.3f} s"
        )
    made = Figure(figsize=PAGE, dpi=DOTS, layout="constrained")
    FigureCanvasAgg(made)
    made.suptitle(_title(recording), fontsize=9, x=0.01, ha="left", parse_math=False)
    grid = made.subplots(len(panels), 1, sharex=True, height_ratios=[height for _, height in panels])
    axes = list(np.atleast_1d(grid))
    for (draw, _), panel in zip(panels, axes, strict=True):
        panel.grid(True, color="0.92", linewidth=0.6)
        panel.tick_params(labelsize=7)
        draw(panel, sheet)
        _shade(panel, sheet)
    axes[-1].set_xlabel("s since the start", fontsize=8)
    axes[0].set_xlim(begin, end if end > begin else begin + 1.0)
    return made


def save(made: Figure, out: Path) -> None:
    """As PNG, with all that is in it or not at all."""
    new = out.with_name(f".{out.name}.new")
    try:
        with open(open_new(new, 0o666), "wb") as file:
            made.savefig(file, format="png", dpi=DOTS)
        new.replace(out)
    finally:
        new.unlink(missing_ok=True)


def _joints_with_data(recording: RobotRecording, joints: Sequence[str]) -> tuple[str, ...]:
    for name in joints:
        if name not in recording.joints:
            raise ValueError(f"no joint {name!r}; known: {', '.join(recording.joints)}")
    if not 0 < len(joints) <= len(COLOURS):
        raise ValueError(f"{len(joints)} joints in colour; 1 to {len(COLOURS)} can be told apart")
    return tuple(dict.fromkeys(joints))


def _last(recording: RobotRecording) -> float:
    """Time (s) of the last message: a fault often comes after the last reading."""
    times = [each.time for each in (*recording.events, *recording.verdicts)]
    return max([0.0, *map(float, recording.time[-1:]), *times])


def _title(recording: RobotRecording) -> str:
    """Robot and file; when, how long and by whom; what is wrong with the file."""
    meta = recording.meta
    begun = datetime.fromtimestamp(recording.start_ns / 1e9, UTC)
    robot = meta.get("individual") or meta.get("robot") or "robot"
    modes = dict.fromkeys(str(each.what.get("mode")) for each in recording.statuses)
    said = [
        f"{begun:%Y-%m-%d %H:%M:%S} UTC",
        f"{recording.duration:.1f} s",
        "/".join(modes) or meta.get("mode", ""),
    ]
    said.append(f"twind {meta['version']}" if "version" in meta else "")
    lines = [f"{robot}   {recording.path.name}", "   ".join(filter(None, said))]
    return "\n".join([*lines, f"not whole: {recording.damage}"] if recording.damage else lines)


# --------------------------------------------------------------------------------------------- panels


def _tracking(panel: Axes, sheet: PlotContext) -> None:
    """Commanded (dashed) and measured positions of the joints in colour."""
    recording = sheet.recording
    for style, values in ((":", recording.goal), ("-", recording.target)):
        for name, each in sheet.columns(recording.time, values):
            if name in sheet.colours:
                colour = sheet.colours[name]
                _draw(panel, each, style, color=colour, linewidth=1.1, label=f"{name} {style}")
    panel.set_ylabel(f"commanded ···\n{_followed(recording)} —  (rad)", fontsize=8)
    handles = [Line2D([], [], color=colour, label=name) for name, colour in sheet.colours.items()]
    handles += [Line2D([], [], color=GREY, label="the others")] * (len(recording.joints) > len(handles))
    _legend(panel, handles=handles, ncols=4)


def _followed(recording: RobotRecording) -> str:
    """The target of commands: the robot, its simulation, or each for a part of the time."""
    live = recording.live
    if live.any() and not live.all():
        return "measured (live), simulated"
    return "measured" if live.any() else "simulated"


def _error(panel: Axes, sheet: PlotContext) -> None:
    recording = sheet.recording
    error = recording.goal - recording.target
    word = _followed(recording)
    _joints(panel, sheet, recording.time, error, f"commanded less\n{word}  (rad)")


def _effort(panel: Axes, sheet: PlotContext) -> None:
    _joints(panel, sheet, sheet.recording.time, sheet.recording.effort, "effort  (N·m)")


def _external(panel: Axes, sheet: PlotContext) -> None:
    known = sheet.recording.external
    assert known is not None
    _joints(panel, sheet, known.time, known.torque, "from outside\n(N·m)")
    inside = (known.time >= sheet.window[0]) & (known.time <= sheet.window[1])
    touched = np.flatnonzero(known.contact[inside].any(axis=0))
    if touched.size:
        names = ", ".join(sheet.recording.joints[place] for place in touched[:NAMED])
        where = panel.transAxes
        text = f"contact: {names}"
        panel.text(0.01, 0.95, text, va="top", fontsize=6, color=NOTABLE, transform=where, parse_math=False)


def _temperature(panel: Axes, sheet: PlotContext) -> None:
    slow = sheet.recording.slow
    assert slow is not None
    _joints(panel, sheet, slow.time, slow.temperature, "temperature  (°C)")


def _voltage(panel: Axes, sheet: PlotContext) -> None:
    slow = sheet.recording.slow
    assert slow is not None
    _joints(panel, sheet, slow.time, slow.voltage, "supply  (V)")


def _joints(panel: Axes, sheet: PlotContext, time: Floats, values: Floats, label: str) -> None:
    for name, each in sheet.columns(time, values):
        colour = sheet.colours.get(name, GREY)
        width = 1.1 if name in sheet.colours else 0.6
        _draw(panel, each, color=colour, linewidth=width, label=name)
    panel.set_ylabel(label, fontsize=8)


def _draw(panel: Axes, each: PlotLine, style: str = "-", **look: Any) -> None:
    """The line, and a dot for each value alone, which is no line."""
    panel.plot(each.time, each.value, style, marker=".", markersize=2.5, markevery=each.alone, **look)


def _legend(panel: Axes, **look: Any) -> None:
    """Above the panel. A dollar in a name is a dollar, no formula."""
    made = panel.legend(fontsize=7, loc="lower left", bbox_to_anchor=(0.0, 1.0), frameon=False, **look)
    for text in made.get_texts():
        text.set_parse_math(False)


def _gap(panel: Axes, sheet: PlotContext) -> None:
    time, shares = gap_shares(sheet.recording)
    _joints(panel, sheet, time, 100.0 * shares, "gap: motion\nunexplained  (%)")
    panel.set_ylim(bottom=0.0)


def _latency(panel: Axes, sheet: PlotContext) -> None:
    for name, colour in zip(HOPS, COLOURS, strict=False):
        each = _hop(sheet, name)
        if each.time.size:
            _draw(panel, each, color=colour, linewidth=0.9, label=name)
    panel.set_yscale("log")
    panel.yaxis.set_major_formatter(ScalarFormatter())
    panel.set_ylabel("latency  (ms)", fontsize=8)
    _legend(panel, ncols=len(HOPS), borderpad=0.0)


def _hop(sheet: PlotContext, name: str) -> PlotLine:
    hop = sheet.recording.latency.get(name)
    nothing = np.zeros(0)
    return line(hop.time, hop.columns["now_ms"], sheet.window) if hop else PlotLine(nothing, nothing)


def _happened(panel: Axes, sheet: PlotContext) -> None:
    """A mark for each thing that happened, with its word while there is room."""
    found = marks(sheet.recording, sheet.window)
    middle = sum(sheet.window) / 2  # words of the right half stand left of their mark: none leaves the page
    for place, mark in enumerate(found):
        panel.plot([mark.time], [0.0], marker="|", markersize=9, color=_colour(mark), label=mark.text)
        if place < NAMED:
            panel.annotate(
                mark.text,
                (mark.time, 0.0),
                (2 if mark.time < middle else -2, 6 + 8 * (place % 5)),
                textcoords="offset points",
                ha="left" if mark.time < middle else "right",
                fontsize=6,
                color=_colour(mark),
                parse_math=False,
            )
    panel.set_yticks([])
    panel.set_ylim(-0.4, 3.0)
    more = f"\n{len(found) - NAMED} more" if len(found) > NAMED else ""
    panel.set_ylabel(f"what happened{more}", fontsize=8)


def _colour(mark: PlotMark) -> str:
    return BAD if mark.bad else NOTABLE


def _shade(panel: Axes, sheet: PlotContext) -> None:
    """Episodes as a shade, faults as lines, in every panel."""
    begin, end = sheet.window
    for episode in sheet.recording.episodes:
        left = episode.begin if isfinite(episode.begin) else begin
        right = episode.end if isfinite(episode.end) else end
        panel.axvspan(max(left, begin), min(right, end), color=EPISODE, alpha=0.18, linewidth=0)
    for mark in marks(sheet.recording, sheet.window):
        if mark.bad:
            panel.axvline(mark.time, color=BAD, linewidth=0.8, linestyle="--")


def _has(values: Callable[[PlotContext], tuple[Floats, Floats] | None]) -> Callable[[PlotContext], bool]:
    """A check that any of these values is known in the drawn time window."""

    def known(sheet: PlotContext) -> bool:
        told = values(sheet)
        if told is None:
            return False
        time, table = told
        inside = (time >= sheet.window[0]) & (time <= sheet.window[1])
        return bool(np.isfinite(table[inside]).any())

    return known


def _outside(sheet: PlotContext) -> tuple[Floats, Floats] | None:
    known = sheet.recording.external
    return None if known is None else (known.time, known.torque)


def _slow(sheet: PlotContext, name: str) -> tuple[Floats, Floats] | None:
    slow = sheet.recording.slow
    return None if slow is None else (slow.time, getattr(slow, name))


PANELS: Sequence[tuple[Callable[[Axes, PlotContext], None], float, Callable[[PlotContext], bool]]] = (
    (_tracking, 2.4, _has(lambda sheet: (sheet.recording.time, sheet.recording.target))),
    (_error, 1.5, _has(lambda sheet: (sheet.recording.time, sheet.recording.goal - sheet.recording.target))),
    (_effort, 1.2, _has(lambda sheet: (sheet.recording.time, sheet.recording.effort))),
    (_external, 1.0, _has(_outside)),
    (_gap, 1.0, _has(lambda sheet: gap_shares(sheet.recording))),
    (_latency, 1.2, lambda sheet: any(_hop(sheet, name).time.size for name in HOPS)),
    (_temperature, 1.0, _has(lambda sheet: _slow(sheet, "temperature"))),
    (_voltage, 0.9, _has(lambda sheet: _slow(sheet, "voltage"))),
    (_happened, 0.9, lambda sheet: bool(marks(sheet.recording, sheet.window))),
)
