"""Disturbances while an episode runs: pushes of the base, and noise on the readings."""

from collections.abc import Iterable, Sequence
from dataclasses import astuple

import numpy as np

from twind.learn.randomise.randomisation_ranges import NoiseRanges, PushRanges, Span
from twind.learn.task.observation import BodyReading
from twind.robot.arrays import Bools, Floats

NEVER = np.iinfo(np.int64).max


class PushSchedule:
    """The pushes of `count` simulations, counted in control steps of each one's episode."""

    def __init__(self, ranges: PushRanges | None, mass: float, period: float, count: int = 1) -> None:
        """`mass` of the robot, kg; `period` of a control step, s."""
        self._ranges = ranges
        self._mass = mass
        self._period = period
        self.force: Floats = np.zeros((count, 2))  # N, world frame, through the next control step
        self._on: Bools = np.zeros(count, np.bool_)  # a push may have no force
        self._due = np.full(count, NEVER)  # the step, of all since the start, at which the force changes
        self._now = 0
        self._soonest = NEVER

    def begin(self, at: Iterable[int], rngs: Sequence[np.random.Generator]) -> None:
        """Episodes begin in the simulations `at`; `rngs`: the generators of all."""
        if self._ranges is None:
            return
        for each in at:
            self._pause(each, rngs[each])
        self._soonest = int(self._due.min())

    def step(self, rngs: Sequence[np.random.Generator]) -> bool:
        """Before each control step. True: `force` has changed, of at least one."""
        changed = self._now >= self._soonest
        if changed:
            for each in np.flatnonzero(self._due <= self._now).tolist():
                if self._on[each]:
                    self._pause(each, rngs[each])
                else:
                    self._push(each, rngs[each])
            self._soonest = int(self._due.min())
        self._now += 1
        return changed

    def _pause(self, each: int, rng: np.random.Generator) -> None:
        assert self._ranges is not None
        self.force[each] = 0.0
        self._on[each] = False
        self._due[each] = self._now + self._steps(self._ranges.every, rng)

    def _push(self, each: int, rng: np.random.Generator) -> None:
        assert self._ranges is not None
        steps = self._steps(self._ranges.lasting, rng)
        size = self._mass * rng.uniform(*self._ranges.speed) / (steps * self._period)
        way = rng.uniform(-np.pi, np.pi)
        self.force[each] = size * np.cos(way), size * np.sin(way)
        self._due[each] = self._now + steps
        self._on[each] = True

    def _steps(self, span: Span, rng: np.random.Generator) -> int:
        return max(1, round(rng.uniform(*span) / self._period))


_SIZES = (3, 3, 3, 1, 3, 6, 6)  # of what follows positions and velocities in a reading


class ReadingNoise:
    """Even noise on the readings (count, 2n + 25) of `count` simulations, or on one (2n + 25)."""

    def __init__(self, ranges: NoiseRanges, joints: int, count: int = 1) -> None:
        most: Floats = np.repeat(astuple(ranges), (joints, joints, *_SIZES))
        self.silent = not most.any()
        self._tilted = ranges.gravity > 0.0
        self._width = 2.0 * most
        self._most = most
        self._even = np.zeros((count, most.size))

    def add(self, reading: BodyReading, rngs: Sequence[np.random.Generator]) -> None:
        """Lay noise over `reading`, in place; `rngs`: one of each simulation. Gravity keeps length 1."""
        if self.silent:
            return
        even = self._even
        for row, rng in zip(even, rngs, strict=True):
            rng.random(out=row)
        even *= self._width
        even -= self._most
        reading.values += even.reshape(reading.values.shape)
        if self._tilted:
            reading.gravity /= np.sqrt((reading.gravity**2).sum(-1, keepdims=True))
