"""Samples of a motion: what was commanded and what was measured. Arrays are (t, n), n joints."""

from dataclasses import dataclass

import numpy as np

from twind.robot.arrays import Floats


@dataclass(frozen=True, slots=True)
class MotionSamples:
    """Readings of a robot and the goals that acted on it. NaN: unknown.

    `goal[k]` acts from `time[k]` until `time[k + 1]`; the other columns were measured at `time[k]`.
    """

    names: tuple[str, ...]
    time: Floats  # s, (t,), increasing
    goal: Floats  # rad, (t, n)
    position: Floats  # rad, (t, n)
    velocity: Floats  # rad/s, (t, n)
    effort: Floats  # N·m, (t, n)
    supply: Floats | None = None  # V, (t, n); None: not recorded

    @property
    def period(self) -> float:
        """Median time between two samples, s; NaN for fewer than two."""
        return float(np.median(np.diff(self.time))) if len(self.time) > 1 else float("nan")

    def rows(self, first: int, last: int) -> "MotionSamples":
        """Return the samples `first` to before `last`."""
        part = slice(first, last)
        return MotionSamples(
            names=self.names,
            time=self.time[part],
            goal=self.goal[part],
            position=self.position[part],
            velocity=self.velocity[part],
            effort=self.effort[part],
            supply=None if self.supply is None else self.supply[part],
        )
