"""Noise on readings: each quantity by its own range, of each simulation from its own generator."""

from collections.abc import Sequence
from dataclasses import astuple

import numpy as np

from twind.learn.observation import BodyReading
from twind.learn.randomise.randomisation_ranges import NoiseRanges
from twind.robot.arrays import Floats

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
