"""Plots of the last seconds: tracking, one joint, latency. Numbers are made here; viser's uPlot draws
them."""

from html import escape
from math import floor, log10
from typing import Any

import numpy as np

from twind.observe.viewing.viewer_state import WINDOW, ViewerState
from twind.robot.arrays import Floats

POINTS = 300  # of a line where there are more: those of note alone
HOPS = ("total", "twin", "command")  # that are plotted, where the daemon reports them
COLOURS = ("#2563eb", "#dc2626", "#16a34a", "#9333ea")
WORST = "the furthest off"
NOISE = 1e-3  # rad
HEIGHT = 150  # px
Line = tuple[Floats, ...]


def tracking(known: ViewerState) -> Line:
    """Time (k,) s before now; error of the worst joint and root of the mean square, mrad."""
    path = known.path()
    if not path:
        return _nothing(3)
    error = np.round(
        np.array([each.error for each in path]) * 1e3, 2
    )  # a flat line is not drawn as its noise
    told = np.isfinite(error)
    some = told.any(axis=1)
    filled = np.where(told, error, 0.0)
    rms = np.sqrt((filled**2).sum(axis=1) / np.maximum(told.sum(axis=1), 1))
    return _of_note(
        np.array([each.time - path[-1].time for each in path]),
        np.where(some, filled.max(axis=1), np.nan),
        np.where(some, rms, np.nan),
    )


def worst(known: ViewerState) -> int | None:
    """Return the joint with the largest error in that time; None: no error was larger than noise."""
    path = known.path()
    if not path:
        return None
    most = np.nan_to_num(np.array([each.error for each in path])).max(axis=0)
    return int(np.argmax(most)) if most.max() > NOISE else None


def joint(known: ViewerState, place: int) -> Line:
    """Time (k,) s before now; goal, measured and simulated of one joint, rad."""
    path = known.path()
    if not path:
        return _nothing(4)
    columns = [[each.goal[place], each.measured[place], each.simulated[place]] for each in path]
    lines = np.round(np.array(columns).T, 4)
    return _of_note(np.array([each.time - path[-1].time for each in path]), *lines)


def _of_note(time: Floats, *lines: Floats) -> Line:
    """Thin out samples: of more than `POINTS`, keep the least and the greatest of each line in each stretch.

    So no peak is lost.
    """
    if time.size <= POINTS:
        return (time, *lines)
    kept: set[int] = set()
    for stretch in np.array_split(np.arange(time.size), POINTS // len(lines)):
        kept |= {int(stretch[0])}
        for line in lines:
            known = stretch[np.isfinite(line[stretch])]
            if known.size:
                kept |= {int(known[line[known].argmin()]), int(known[line[known].argmax()])}
    places = sorted(kept)
    return (time[places], *(line[places] for line in lines))


def latency(known: ViewerState) -> Line:
    """Time (k,) s before now; ms of `HOPS`, NaN where the daemon does not tell."""
    hops = known.hops()
    if not hops:
        return _nothing(1 + len(HOPS))
    times = np.array([time for time, _ in hops])
    return (times - times[-1], *(np.array([each.get(hop, np.nan) for _, each in hops]) for hop in HOPS))


def _nothing(count: int) -> Line:
    return tuple(np.array([np.nan if n else 0.0]) for n in range(count))


class LivePlots:
    """The three of them in the panel that is being filled."""

    def __init__(self, gui: Any, known: ViewerState) -> None:
        self._gui = gui
        self._known = known
        self._names: tuple[str, ...] = ()
        self._shown = 0  # the joint that is plotted
        self._tracking = _plot(gui, "tracking error, mrad", ("worst", "rms"))
        self._which = gui.add_dropdown("joint", options=(WORST,), initial_value=WORST)
        self._name = gui.add_html("")
        self._joint = _plot(gui, "rad", ("goal", "measured", "simulated"))
        self._latency = _plot(gui, "latency, ms", HOPS)

    def set_joints(self, names: tuple[str, ...]) -> None:
        """The joints of another robot."""
        if names != self._names:
            self._names = names
            self._shown = 0
            self._which.options = (WORST, *names)
            self._which.value = WORST

    def draw(self) -> None:
        """Draw the plots with the newest values."""
        known = self._known
        _fill(self._tracking, tracking(known))
        chosen = self._which.value
        place = self._names.index(chosen) if chosen in self._names else worst(known)
        if place is not None and place < len(self._names):
            self._shown = place
        if self._names:
            _fill(self._joint, joint(known, self._shown))
            name = f'<div style="text-align:center">{escape(self._names[self._shown])}</div>'
            if self._name.content != name:  # beside the plot: a new title makes it forget its data
                self._name.content = name
        _fill(self._latency, latency(known))


def extent(lines: Line) -> tuple[float, float]:
    """Return the ends of the upright axis, in round steps so that they seldom change.

    uPlot's own range draws nothing at all of lines whose first value is unknown.
    """
    values = np.concatenate(lines) if lines else np.empty(0)
    values = values[np.isfinite(values)]
    if not values.size:
        return 0.0, 1.0
    least = float(values.min())
    most = float(values.max())
    span = max(most - least, abs(most) * 1e-3, 1e-3)
    step = 10.0 ** floor(log10(span)) / 2.0
    return min(least, floor(least / step) * step), (floor(most / step) + 1) * step


def _fill(plot: Any, data: Line) -> None:
    scales = _scales(*extent(data[1:]))
    if plot.scales != scales:
        plot.scales = scales
    plot.data = data


def _scales(least: float, most: float) -> dict[str, object]:
    x = {
        "time": False,
        "auto": False,
        "range": (-WINDOW, 0.0),
    }  # its own is forgotten when another one changes
    return {"x": x, "y": {"auto": False, "range": (least, most)}}


def _plot(gui: Any, title: str, names: tuple[str, ...]) -> Any:
    lines = (
        {"label": name, "stroke": colour, "width": 1.5, "points": {"show": False}}
        for name, colour in zip(names, COLOURS, strict=False)
    )
    return gui.add_uplot(
        data=_nothing(1 + len(names)),
        series=({}, *lines),
        title=title,
        scales=_scales(0.0, 1.0),
        axes=({}, {"size": 64}),  # px: its own guess cuts a sign or a digit off
        legend={"show": True, "live": False},
        padding=(10, 8, 0, 0),
        height=HEIGHT,
    )
