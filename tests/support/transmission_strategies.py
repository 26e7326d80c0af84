"""Transmissions for properties: differentials, tables of one and two actuators, places of their actuators."""

import math

import numpy as np
from hypothesis import assume
from hypothesis import strategies as st

from twind.robot.linkage_table import LinkageTable
from twind.robot.transmission import MOST_CONDITION, Differential, Transmission

SIZES = st.floats(-3.0, 3.0).map(lambda x: round(x, 3))


@st.composite
def differentials(draw: st.DrawFn) -> Differential:
    """Well conditioned ones, of one to three joints."""
    count = draw(st.integers(1, 3))
    rows = np.array(draw(st.lists(SIZES, min_size=count**2, max_size=count**2))).reshape(count, count)
    assume(abs(np.linalg.det(rows)) > 1e-2 and np.linalg.cond(rows) < MOST_CONDITION)
    return Differential(rows.tolist())


def warped(x: float, y: float, bend: float, turn: float) -> tuple[float, float]:
    """A smooth map of the plane that does not fold within |x|, |y| <= 1."""
    u = x + bend * math.sin(y) * 0.3
    v = y - bend * x * x * 0.2
    c = math.cos(turn)
    s = math.sin(turn)
    return 0.6 * (c * u - s * v), 0.4 * (s * u + c * v)


@st.composite
def tables(draw: st.DrawFn) -> LinkageTable:
    """One or two actuators, uneven grids, mirrored or not."""
    axes = [
        sorted(draw(st.sets(st.integers(-50, 50), min_size=2, max_size=6)))
        for _ in range(draw(st.integers(1, 2)))
    ]
    grid = [[place / 50.0 for place in axis] for axis in axes]
    way = draw(st.sampled_from([1.0, -1.0]))
    if len(grid) == 1:
        return LinkageTable(grid, [[way * (x + 0.3 * math.sin(2.0 * x))] for x in grid[0]])
    bend = draw(st.floats(0.0, 1.0))
    turn = draw(st.floats(0.0, 6.0))
    rows = [warped(x, y, bend, turn) for x in grid[0] for y in grid[1]]
    return LinkageTable(grid, [[a, way * b] for a, b in rows])


@st.composite
def placed(draw: st.DrawFn) -> tuple[Transmission, np.ndarray]:
    """A transmission and a place of its actuators."""
    law: Transmission = draw(st.one_of(differentials(), tables()))
    if isinstance(law, LinkageTable):
        shares = [draw(st.floats(0.0, 1.0)) for _ in law.axes]
        ends = [(axis[0], axis[-1]) for axis in law.axes]
        return law, np.array([a + s * (b - a) for s, (a, b) in zip(shares, ends, strict=True)])
    assert isinstance(law, Differential)
    return law, np.array([draw(st.floats(-3.0, 3.0)) for _ in law.rows])
