"""Something pushes the robot now and then: a force in the plane on its base, for a short while."""

from collections.abc import Iterable, Sequence

import numpy as np

from twind.learn.randomise.randomisation_ranges import PushRanges, Span
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
