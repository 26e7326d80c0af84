"""Proof that polynomials stay under a bound, without sampling: Bernstein form and halving.

A polynomial on 0 <= u <= 1 lies within the hull of its Bernstein coefficients. The first and the last of them
are its values at the ends. A hull under the bound proves that all is under it; an end above it proves the
opposite. An open interval is halved: the hull closes in by a factor of four each time. Coefficients stand on
axis 0, (degree + 1, ...). NaN counts as above every bound.
"""

from collections.abc import Callable, Sequence
from math import comb

import numpy as np

from twind.robot.arrays import Floats, Ints

DEPTH = 26  # halvings: the hull is then within 4**-26 of its first width, below rounding
CROWD = 16  # open pieces per column: a polynomial of degree 8 touches a bound in fewer places
COARSE = np.linspace(0.0, 1.0, 11)  # of a quintic's acceleration, or a brake reach, no peak hides between
PROMISING = 4  # columns of a group that are refined
ZOOMS = 6  # rounds of closing in on a highest point: to 1e-5 of a segment, so to 1e-10 in height
GRID = np.linspace(-1.0, 1.0, 13)
GRID.setflags(write=False)


def square(curve: Floats) -> Floats:
    """Return the square of a polynomial, of twice the degree."""
    d = len(curve) - 1
    product = np.zeros((2 * d + 1, *curve.shape[1:]))
    for i in range(d + 1):
        for j in range(d + 1):
            product[i + j] += comb(d, i) * comb(d, j) / comb(2 * d, i + j) * curve[i] * curve[j]
    return product


def elevate(curve: Floats, degree: int) -> Floats:
    """Return the same polynomial, written in a higher degree."""
    while len(curve) - 1 < degree:
        share = (np.arange(1, len(curve)) / len(curve)).reshape(-1, *[1] * (curve.ndim - 1))
        inner = share * curve[:-1] + (1.0 - share) * curve[1:]
        curve = np.concatenate([curve[:1], inner, curve[-1:]])
    return curve


def evaluate(curve: Floats, u: Floats) -> Floats:
    """Return the values at `u` (broadcast against `curve[0]`), by de Casteljau."""
    while len(curve) > 1:
        curve = curve[:-1] + u * (curve[1:] - curve[:-1])
    values: Floats = curve[0] + 0.0 * u
    return values


def halves(curve: Floats) -> tuple[Floats, Floats]:
    """Return the polynomial over the first and over the second half of its interval."""
    left = [curve[0]]
    right = [curve[-1]]
    while len(curve) > 1:
        curve = 0.5 * (curve[:-1] + curve[1:])
        left.append(curve[0])
        right.append(curve[-1])
    return np.stack(left), np.stack(right[::-1])


def exceeds(alternatives: Sequence[tuple[Floats, Floats]]) -> Floats:
    """Return for each of m columns a u in 0..1 where every alternative exceeds its bound; NaN: none.

    An alternative is a polynomial (degree + 1, m) and its bound (m,). A column that `DEPTH` halvings cannot
    decide counts as above: a touch within rounding, or more touches than such a polynomial can have.
    """
    curves = [curve for curve, _ in alternatives]
    bounds = [bound for _, bound in alternatives]
    found = np.full(curves[0].shape[1], np.nan)
    column = np.arange(len(found))
    start = np.zeros(len(found))
    width = 1.0
    for _ in range(DEPTH):
        under = np.zeros(len(column), np.bool_)
        first = ~under
        last = ~under
        for curve, bound in zip(curves, bounds, strict=True):
            inside = curve <= bound
            under |= inside.all(axis=0)
            first &= ~inside[0]
            last &= ~inside[-1]
        found[column[last]] = start[last] + width
        found[column[first]] = start[first]
        left = ~under & np.isnan(found[column])
        if not left.any():
            return found
        if np.count_nonzero(left) > CROWD * len(found):
            break
        width *= 0.5
        column = np.tile(column[left], 2)
        start = np.concatenate([start[left], start[left] + width])
        curves = [np.concatenate(halves(curve[:, left]), axis=1) for curve in curves]
        bounds = [np.tile(bound[left], 2) for bound in bounds]
    still = np.isnan(found[column])
    found[column[still]] = start[still]
    return found


def summit(score: Callable[[Ints, Floats], Floats], found: Floats, group: Ints) -> tuple[Ints, Floats]:
    """Return for each group of columns the column and the u where `score(columns, u)` is highest.

    `found` (m,) is a first u of each column. The most promising columns of each group are refined by zooming.
    The result is a point of the curve, at least as high as every u tried.
    """
    columns = np.arange(len(found))
    coarse = np.column_stack([found, np.broadcast_to(COARSE, (len(found), len(COARSE)))])
    heights = _high(score(columns, coarse))
    best = heights.max(axis=1)
    order = np.lexsort((-best, group))
    rank = np.arange(len(order)) - np.searchsorted(group[order], group[order], side="left")
    columns = order[rank < PROMISING]
    u = coarse[columns, heights[columns].argmax(axis=1)]
    height = best[columns]
    center = np.full(len(columns), 0.5)
    reach = 0.5
    for _ in range(ZOOMS):
        grid = np.clip(center[:, None] + reach * GRID, 0.0, 1.0)
        values = _high(score(columns, grid))
        place = values.argmax(axis=1)
        rows = np.arange(len(columns))
        better = values[rows, place] > height
        u = np.where(better, grid[rows, place], u)
        height = np.where(better, values[rows, place], height)
        center = u
        reach = reach / 6.0
    order = np.lexsort((-height, group[columns]))
    first = np.unique(group[columns][order], return_index=True)[1]
    return columns[order][first], u[order][first]


def _high(score: Floats) -> Floats:
    """Return the score with NaN as the highest of all."""
    return np.where(np.isnan(score), np.inf, score)
