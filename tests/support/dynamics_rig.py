"""Poses and torque checks of paths."""

from collections.abc import Iterator

import numpy as np

from twind.robot.arrays import Floats
from twind.robot.finding import Verdict
from twind.twin.binding import Binding
from twind.twin.dynamics import Dynamics


def pose(binding: Binding, **angles: float) -> Floats:
    q = np.array(binding.rest)
    for name, angle in angles.items():
        q[binding.joint_map.names.index(name)] = angle
    return q


def run(steps: Iterator[None]) -> tuple[Verdict, int]:
    slices = 0
    while True:
        try:
            next(steps)
        except StopIteration as stop:
            return stop.value, slices
        slices += 1


def judge(binding: Binding, position: Floats, acceleration: Floats | None = None) -> Verdict:
    """Samples of a path that takes 1 s."""
    still = np.zeros_like(position)
    time = np.linspace(0.0, 1.0, len(position))
    return run(
        Dynamics(binding).judging(time, position, still, still if acceleration is None else acceleration)
    )[0]
