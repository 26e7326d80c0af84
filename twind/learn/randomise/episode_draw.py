"""One draw: the values of one simulation for one episode. A pure function of a generator's state.

All figures of a draw are one vector of even random numbers, so a draw costs a few microseconds.
"""

from typing import NamedTuple

import numpy as np

from twind.learn.randomise.randomisation_ranges import RandomisationRanges, Span
from twind.robot.arrays import Floats


class EpisodeDraw(NamedTuple):
    """Drawn values of one episode; n joints, b links. x: a factor, +: an addition."""

    friction: float  # x, sliding friction of every contact
    mass: Floats  # x, (b,), mass and inertia
    centre_of_mass: Floats  # + m, (3,), of the base, in its frame
    armature: Floats  # x, (n,)
    damping: Floats  # x, (n,)
    frictionloss: Floats  # x, (n,)
    stiffness: Floats  # x, (n,), position gain
    braking: Floats  # x, (n,), velocity gain
    encoder_zero: Floats  # rad, (n,): the encoder says this much more than is
    action_delay: float  # s
    imu_delay: float  # s
    start_joints: Floats  # + rad, (n,)
    start_tilt: Floats  # + rad, (2,): roll, pitch
    start_velocity: Floats  # + m/s, (2,): of the base, forward and left


class DrawSampler:
    """Draws within ranges, of a robot with `joints` joints and `links` links."""

    def __init__(self, ranges: RandomisationRanges, joints: int, links: int) -> None:
        known = {"mass": links, "centre_of_mass": 3, "start_tilt": 2, "start_velocity": 2}
        sizes = [1 if name in _SINGLE else known.get(name, joints) for name in EpisodeDraw._fields]
        spans: list[Span] = [getattr(ranges, name) for name in EpisodeDraw._fields]
        ends = np.cumsum(sizes).tolist()
        self._parts: list[slice | int] = [  # a number, or a run of them
            end - 1 if name in _SINGLE else slice(end - size, end)
            for name, size, end in zip(EpisodeDraw._fields, sizes, ends, strict=True)
        ]
        self._low = np.repeat([low for low, _ in spans], sizes)
        self._width = np.repeat([high - low for low, high in spans], sizes)
        self._any = bool(self._width.any())

    def draw(self, rng: np.random.Generator) -> EpisodeDraw:
        """The next draw: as many random numbers whatever the ranges are, none where all are points."""
        values = self._low.copy()
        if self._any:
            values += rng.random(values.size) * self._width
        values.setflags(write=False)
        return EpisodeDraw._make(values[part] for part in self._parts)


_SINGLE = ("friction", "action_delay", "imu_delay")
