"""Cells of a linkage's table, and an index of those that may hold given joint angles. Pure.

Scalars instead of arrays: to test a cell takes a microsecond, to solve it some ten.
"""

from collections.abc import Sequence
from itertools import product
from math import ceil, isfinite

import numpy as np

Numbers = tuple[float, ...]
STEPS = 20  # of Newton's method within one cell: three or four suffice
CLOSE = 1e-9  # of a cell, or rad: the effect of rounding
EXACT = 1e-12  # of a cell: Newton's method has converged


class TableCell:
    """One cell of a table: value = c + x s + y t + z s t, s, t in 0..1 across it; of one axis y = z = 0."""

    def __init__(self, corner: Numbers, size: Numbers, block: list[list[float]]) -> None:
        """`block`: the values at its corners, last axis fastest."""
        self.corner = corner
        self.size = size
        self.low, self.high = ([edge(column) for column in zip(*block, strict=True)] for edge in (min, max))
        self._sides = _sides(block)
        if len(corner) == 1:
            self._terms = [(a, b - a, 0.0, 0.0) for a, b in zip(*block, strict=True)]
        else:
            self._terms = [(a, c - a, b - a, d - c - b + a) for a, b, c, d in zip(*block, strict=True)]

    def may_hold(self, wanted: list[float]) -> bool:
        """Check whether joint angles are on the inner side of every side of the cell's image."""
        first = wanted[0]
        last = wanted[-1]
        return all(x * first + y * last >= least for x, y, least in self._sides)

    def angles(self, share: Sequence[float]) -> Numbers:
        """Return actuator angles at a share of the cell."""
        return tuple(a + s * w for a, s, w in zip(self.corner, share, self.size, strict=True))

    def value(self, share: Sequence[float]) -> list[float]:
        """Return joint angles at a share of the cell."""
        s = share[0]
        t = share[-1] if len(share) == 2 else 0.0
        return [c + x * s + y * t + z * s * t for c, x, y, z in self._terms]

    def slopes(self, share: Sequence[float]) -> list[list[float]]:
        """Return dq/da at a share of the cell."""
        if len(share) == 1:
            return [[self._terms[0][1] / self.size[0]]]
        (s, t), (width, height) = share, self.size
        return [[(x + z * t) / width, (y + z * s) / height] for _, x, y, z in self._terms]

    def solve(self, wanted: list[float]) -> Numbers | None:
        """Return actuator angles within this cell that give these joint angles; None: there are none."""
        share = [0.5] * len(self.corner)
        for _ in range(STEPS):
            step = self._newton(share, wanted)
            if step is None:
                return None
            share = [min(max(s + d, -0.5), 1.5) for s, d in zip(share, step, strict=True)]
            if max(map(abs, step)) < EXACT:
                break
        inside = all(-CLOSE <= s <= 1.0 + CLOSE for s in share)
        wrong = self._newton(share, wanted) if inside else None
        if wrong is None or max(map(abs, wrong)) > CLOSE:
            return None
        return self.angles([min(max(s, 0.0), 1.0) for s in share])

    def _newton(self, share: list[float], wanted: list[float]) -> list[float] | None:
        """Return the next step, in shares of the cell; None where there is none."""
        miss = [w - v for w, v in zip(wanted, self.value(share), strict=True)]
        if len(share) == 1:
            slope = self._terms[0][1]
            return [miss[0] / slope] if slope else None
        s, t = share
        (a, b), (c, d) = ((x + z * t, y + z * s) for _, x, y, z in self._terms)
        det = a * d - b * c
        if not det:
            return None
        return [(d * miss[0] - b * miss[1]) / det, (a * miss[1] - c * miss[0]) / det]


class CellIndex:
    """Index of the cells that may hold joint angles: those in the same square of a coarse grid of them."""

    def __init__(self, cells: list[TableCell]) -> None:
        self._low = [min(numbers) for numbers in zip(*(cell.low for cell in cells), strict=True)]
        high = [max(numbers) for numbers in zip(*(cell.high for cell in cells), strict=True)]
        self._most = ceil(len(cells) ** (1.0 / len(high)))
        self._per = [self._most / ((b - a) or 1.0) for a, b in zip(self._low, high, strict=True)]
        self._squares: dict[Numbers, list[TableCell]] = {}
        for cell in cells:
            slack = [CLOSE * (b - a) for a, b in zip(cell.low, cell.high, strict=True)]
            first = self._square([a - by for a, by in zip(cell.low, slack, strict=True)])
            last = self._square([b + by for b, by in zip(cell.high, slack, strict=True)])
            for square in product(*(range(a, b + 1) for a, b in zip(first, last, strict=True))):
                self._squares.setdefault(square, []).append(cell)

    def near(self, wanted: list[float]) -> Sequence[TableCell]:
        """Return the cells that may hold the joint angles `wanted`; empty if one of these is not finite."""
        return self._squares.get(self._square(wanted), ()) if all(map(isfinite, wanted)) else ()

    def _square(self, wanted: list[float]) -> tuple[int, ...]:
        """Return the grid square of joint angles; beyond the grid the nearest one."""
        places = zip(wanted, self._low, self._per, strict=True)
        return tuple(int(min(max((q - low) * per, 0.0), self._most - 1.0)) for q, low, per in places)


def _sides(block: list[list[float]]) -> list[tuple[float, float, float]]:
    """Return (x, y, least) of each side of a cell's image: x q1 + y q2 >= least inside.

    None where it folds.

    The sides are straight, and the image is convex where det J has one sign: it is the turn at each corner.
    """
    if len(block) == 2:
        (a,), (b,) = sorted(block)
        slack = CLOSE * (b - a)
        return [(1.0, 0.0, a - slack), (-1.0, 0.0, -b - slack)]
    ring = np.array([block[number] for number in (0, 1, 3, 2)])
    along = np.roll(ring, -1, axis=0) - ring
    inward = np.stack([-along[:, 1], along[:, 0]], axis=1)
    least = (inward * ring).sum(axis=1)
    heights = np.stack([(inward * np.roll(ring, by, axis=0)).sum(axis=1) - least for by in (1, 2)])
    way = np.sign(heights[0])
    if not ((np.sign(heights) == way) & (way != 0.0)).all():
        return []
    least = way * least - 2.0 * CLOSE * np.abs(heights).max(axis=0)
    return [(x, y, z) for (x, y), z in zip((way[:, None] * inward).tolist(), least.tolist(), strict=True)]
