"""Selection of what is drawn of a recording: joints, points of a line, marks. Pure; no matplotlib."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twind.observe.recording.recording_columns import Floats, RobotRecording
from twind.robot.modes import RESET_STATES

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#000000", "#7f3c8d")
# Okabe and Ito's, which the colour blind tell apart (yellow left out: too light for a line), and one more.
DRAWN = 6  # joints in colour by default
NOTABLE = 0.05  # of the worst: who is followed better than that needs no colour
GAP = 2.5  # of the usual distance between two values: from here on something is missing between them
MOST = 6000  # points of a line; an A4 page has a thousand columns

Window = tuple[float, float]  # s


@dataclass(frozen=True, slots=True)
class PlotLine:
    """Points (k,), in order of time; a NaN value is a gap."""

    time: Floats  # s
    value: Floats

    @property
    def alone(self) -> NDArray[np.intp]:
        """Places of the values between two gaps, to which no line leads."""
        known = np.pad(np.isfinite(self.value), 1)
        return np.flatnonzero(known[1:-1] & ~known[:-2] & ~known[2:])


@dataclass(frozen=True, slots=True)
class PlotMark:
    """Something that happened. `bad`: an error, or a refusal."""

    time: float  # s
    text: str
    bad: bool


def line(time: Floats, value: Floats, window: Window) -> PlotLine:
    """The known values in the window, and a gap where some are missing; of very many the extremes."""
    known = np.isfinite(value) & (time >= window[0]) & (time <= window[1])
    time = time[known]
    value = value[known]
    if time.size > 2:
        steps = np.diff(time)
        after = np.flatnonzero(steps > GAP * np.median(steps)) + 1
        time = np.insert(time, after, time[after - 1])
        value = np.insert(value, after, np.nan)
    return thinned(PlotLine(time, value))


def thinned(whole: PlotLine) -> PlotLine:
    """Return the whole line, or if it has too many points, the least and greatest of each stretch, and the
    gaps."""
    if whole.time.size <= MOST:
        return whole
    kept = []
    for each in np.array_split(np.arange(whole.time.size), MOST // 2):
        there = each[np.isfinite(whole.value[each])]
        kept.append(each[~np.isfinite(whole.value[each])])
        if there.size:
            kept.append(there[[whole.value[there].argmin(), whole.value[there].argmax()]])
    places = np.unique(np.concatenate(kept))
    return PlotLine(whole.time[places], whole.value[places])


def worst(recording: RobotRecording, window: Window) -> tuple[str, ...]:
    """The joints that are followed worst, the worst first; without goals those that move most."""
    inside = (recording.time >= window[0]) & (recording.time <= window[1])
    error = (recording.goal - recording.target)[inside]
    if not np.isfinite(error).any():
        target = recording.target[inside]
        error = target - _mean(target)
    score = np.sqrt(_mean(np.square(error)))
    score = np.nan_to_num(score, nan=-1.0)
    order = [place for place in np.argsort(-score, kind="stable") if score[place] >= NOTABLE * score.max()]
    return tuple(recording.joints[place] for place in order[:DRAWN])


def _mean(values: Floats) -> Floats:
    """Return the mean of the known values of each column (n,); NaN where a column has none."""
    known = np.isfinite(values)
    count = known.sum(axis=0)
    total = np.where(known, values, 0.0).sum(axis=0)
    mean: Floats = np.where(count, total / np.maximum(count, 1), np.nan)
    return mean


def marks(recording: RobotRecording, window: Window) -> tuple[PlotMark, ...]:
    """Events of note, refusals and who recorded's notes, in order of time."""
    found = []
    for event in recording.events:
        said = event.what
        note = said.get("annotation") or {}
        ended = {True: "success", False: "failure", None: ""}[note.get("success")]
        text = " ".join(filter(None, (note.get("kind"), note.get("task"), note.get("text"), ended)))
        bad = said.get("level") in ("error", "critical") or said.get("code") in RESET_STATES
        if note or bad or said.get("level") == "warning":
            found.append(PlotMark(event.time, text or str(said.get("code")), bad))
    for verdict in recording.verdicts:
        refusals = verdict.what.get("refusals") or ()
        if refusals:
            found.append(PlotMark(verdict.time, f"refused: {refusals[0]['code']}", True))
    inside = (each for each in found if window[0] <= each.time <= window[1])
    return tuple(sorted(inside, key=lambda each: each.time))


def gap_shares(recording: RobotRecording) -> tuple[Floats, Floats]:
    """Return times (m,), s, of statuses that hold a gap, and the share (m, n) that was unexplained then.

    That of the positions; NaN: none is known of the joint.
    """
    found = [(said.time, said.what["gap"]["joints"]) for said in recording.statuses if said.what.get("gap")]
    table = np.full((len(found), len(recording.joints)), np.nan)
    for row, (_, joints) in enumerate(found):
        shares = {each["joint"]: (each["position"] or {}).get("unexplained") for each in joints}
        known = [shares.get(name) for name in recording.joints]
        table[row] = [np.nan if share is None else share for share in known]
    return np.array([time for time, _ in found]), table
