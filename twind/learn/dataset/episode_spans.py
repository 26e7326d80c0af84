"""Parts of a recording that can be learnt from, and the reasons against the others. Pure.

A reading is whole when every joint was measured and had a goal, and goals went to the robot. Two of them that
are further apart than a bound belong to two stretches: nothing is filled in between.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isnan

import numpy as np
from numpy.typing import NDArray

from twind.observe.recording import RobotRecording
from twind.observe.recording.recording_columns import RecordedEpisode
from twind.robot.arrays import Bools


@dataclass(frozen=True, slots=True)
class EpisodeSpan:
    """Something of a recording that was meant as one episode. Times in s since the recording's start."""

    task: str
    begin: float
    end: float
    success: bool | None  # None: not marked


@dataclass(frozen=True, slots=True)
class ReadingRun:
    """Readings `first`..`last` of a recording, both included: whole, and none far from the next."""

    first: int
    last: int


@dataclass(frozen=True, slots=True)
class OmittedSpan:
    """Span that is not in a data set, with the reason. `time` in s since the recording's start."""

    recording: str
    task: str
    time: float
    why: str


class ReadingCoverage:
    """Coverage of one recording, by reading; `gap` s is the longest between two that belong together."""

    def __init__(self, recording: RobotRecording, gap: float) -> None:
        self._recording = recording
        self._gap = gap
        self.measured = ~np.isnan(recording.measured)  # (k, n)
        self.commanded = ~np.isnan(recording.goal)
        self.live = recording.live
        self.silent = _silent(recording, gap)
        # A row without a measurement is a message of another time.
        self.measured_rows = np.asarray(self.measured.any(axis=1))
        whole = self.measured.all(axis=1) & self.commanded.all(axis=1) & self.live
        self.whole: Bools = np.asarray(whole & ~self.silent.any(axis=1))

    def runs(self, part: EpisodeSpan) -> list[ReadingRun]:
        """The stretches of a part, in order; each of one reading at least."""
        rows = self._rows(part)
        whole = self.whole[rows]
        near = np.diff(self._recording.time[rows]) <= self._gap
        joined = np.concatenate([[False], whole[:-1] & whole[1:] & near, [False]])  # to the one before
        first = rows[whole & ~joined[:-1]]
        last = rows[whole & ~joined[1:]]
        return [ReadingRun(int(begin), int(end)) for begin, end in zip(first, last, strict=True)]

    def hole(self, part: EpisodeSpan, after: int | None = None) -> tuple[float, str]:
        """Return time (s) and reason of the first hole of a part, after reading `after` if it is given."""
        time = self._recording.time
        rows = self._rows(part)
        rows = rows if after is None else rows[rows > after]
        if not rows.size:
            return part.begin, "no joint was measured in it"
        row = int(rows[0])
        if after is not None and time[row] - time[after] > self._gap:
            return float(time[after]), f"nothing was read for {time[row] - time[after]:.2f} s"
        return float(time[row]), self._lacks(row)

    def _rows(self, part: EpisodeSpan) -> NDArray[np.intp]:
        time = self._recording.time
        return np.flatnonzero(self.measured_rows & (time >= part.begin) & (time <= part.end))

    def _lacks(self, row: int) -> str:
        if not self.live[row]:
            return "commands went to the simulation, not to the robot"
        for have, state in ((self.measured, "is unknown"), (~self.silent, "did not answer")):
            if not have[row].all():
                return f"{_names(self._recording.joints, ~have[row])} {state}"
        if not self.commanded[row].any():
            return "there are no goals: the robot was not armed"
        return f"{_names(self._recording.joints, ~self.commanded[row])} had no goal"


def parts(recording: RobotRecording, task: str | None) -> tuple[list[EpisodeSpan], list[OmittedSpan]]:
    """The marked episodes, and those of which this file has one end only; without marks all of it is one.

    `task`: of what has none.
    """
    if not recording.episodes:
        end = float(recording.time[-1]) if recording.time.size else 0.0
        return [EpisodeSpan(task or "", 0.0, end, None)], []
    found = []
    left = []
    for each in recording.episodes:
        part = EpisodeSpan(each.task or task or "", each.begin, each.end, each.success)
        cut = _cut(each)
        if cut:
            time = each.end if isnan(each.begin) else each.begin
            left.append(OmittedSpan(recording.path.name, part.task, time, cut))
        else:
            found.append(part)
    return found, left


def _cut(episode: RecordedEpisode) -> str:
    if isnan(episode.begin):
        return "its beginning is not in this file"
    if isnan(episode.end):
        return "its end is not in this file"
    return ""


def _names(joints: Sequence[str], which: Bools) -> str:
    """The first of them by name, the others counted."""
    names = [name for name, on in zip(joints, which, strict=True) if on]
    return names[0] if len(names) == 1 else f"{names[0]} and {len(names) - 1} more"


def _silent(recording: RobotRecording, gap: float) -> Bools:
    """(k, n) readings in which a joint had not answered for longer than `gap`: its number is an old one.

    Ages are recorded twice a second. From one that is too old on, the joint is doubted from its last answer
    until it is known to have answered again.
    """
    found = np.zeros(recording.measured.shape, np.bool_)
    slow = recording.slow
    time = recording.time
    if slow is None:
        return found
    replied = slow.time[:, None] - slow.age  # (m, n) s, NaN: unknown
    for place, joint in np.argwhere(slow.age > gap):
        later = replied[place + 1 :, joint]
        again = later[later > slow.time[place]]
        until = again[0] if again.size else np.inf
        found[(time > replied[place, joint]) & (time < until), joint] = True
    return found
