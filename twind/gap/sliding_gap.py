"""Gap over a sliding window, from samples as they arrive: each second is simulated once."""

from collections import deque

import numpy as np

from twind.gap.gap_figures import JointGap, joint_gaps
from twind.gap.gap_replay import PAST, SEGMENT, WINDOW, GapReplay, resample
from twind.gap.motion_samples import MotionSamples, joined
from twind.robot.arrays import Floats

LONGEST_PAUSE = 0.5  # s without samples, as after a disarm: the window begins anew


class SlidingGap:
    """The last `WINDOW` seconds of a robot, measured and simulated."""

    def __init__(self, replay: GapReplay, names: tuple[str, ...], period: float) -> None:
        self._replay = replay
        self._names = names
        self._period = period
        self._rows: list[Floats] = []  # (1 + 4 n,): time, goal, position, velocity, effort
        self._begin = 0  # row of the next restart; those before it are past goals
        self._segments: deque[tuple[MotionSamples, MotionSamples]] = deque(maxlen=round(WINDOW / SEGMENT))

    def add(self, row: Floats) -> bool:
        """Take one sample: time, then goal, position, velocity, effort (n,) each. True: a second is full."""
        if self._rows and not row[0] > self._rows[-1][0]:
            return False
        if self._rows and row[0] - self._rows[-1][0] > LONGEST_PAUSE:
            self._rows.clear()
            self._segments.clear()
            self._begin = 0
        self._rows.append(row)
        if row[0] - self._rows[self._begin][0] < SEGMENT:
            return False
        samples = resample(self._samples(), self._period)
        first = round((self._rows[self._begin][0] - self._rows[0][0]) / self._period)
        simulated = self._replay.simulate(samples, first)
        end = len(samples.time)
        self._segments.append((samples.rows(first + 1, end), simulated.rows(first + 1, end)))
        self._begin = round(PAST / self._period)
        self._rows = self._rows[-1 - self._begin :]
        self._begin = len(self._rows) - 1
        return True

    def gaps(self) -> list[JointGap]:
        """Return the figures of each joint over the window; none before the first second."""
        if not self._segments:
            return []
        measured, simulated = zip(*self._segments, strict=True)
        return joint_gaps(joined(measured), joined(simulated))

    def _samples(self) -> MotionSamples:
        table = np.array(self._rows)
        goal, position, velocity, effort = np.split(table[:, 1:], 4, axis=1)
        return MotionSamples(self._names, table[:, 0], goal, position, velocity, effort)
