"""Piecewise polynomials in time: the one curve that the gate judges and the executor follows.

Interpolation as `joint_trajectory_controller` does it: positions alone give lines, positions with velocities
cubics, with accelerations too quintics. The first segment runs from the state at arrival to the first point.
"""

from dataclasses import dataclass

import numpy as np

from twind.robot.arrays import Bools, Floats
from twind.robot.trajectory import Reference, Trajectory


@dataclass(frozen=True, slots=True)
class Knots:
    """What a curve passes through. Arrays (k, n); velocity and acceleration as far as the path gives them."""

    time: Floats  # s, (k,), strictly increasing
    position: Floats  # rad
    velocity: Floats | None  # rad/s
    acceleration: Floats | None  # rad/s²


@dataclass(frozen=True, slots=True)
class Spline:
    """Segment i runs over time[i]..time[i+1]; its polynomials are in local time, ascending powers."""

    time: Floats  # s, (s + 1,), strictly increasing; time[0] = 0 unless the path starts later by itself
    coefficients: Floats  # (s, degree + 1, n)
    end: Floats  # rad, (n,), held after the last knot

    @property
    def duration(self) -> float:
        """Time of the last knot, s."""
        return float(self.time[-1])

    def segment(self, t: float) -> int:
        """Index of the segment that `t` falls in; the last one at and after the end."""
        passed = int(self.time.searchsorted(t, side="right")) - 1
        return min(max(passed, 0), len(self.coefficients) - 1)

    def sample(self, t: float) -> Reference | None:
        """The reference at `t` s from start; None before it; at rest on `end` after the last knot."""
        if not t >= 0.0:
            return None
        if t >= self.time[-1] or not len(self.coefficients):
            still = np.zeros_like(self.end)
            return Reference(self.end, still, still)
        return self.inside(self.segment(t), t)

    def inside(self, index: int, t: float) -> Reference:
        """The polynomial of segment `index` at `t` s from start; at a knot the limit from its side."""
        rows = self.coefficients[index]
        powers = _powers(t - float(self.time[index]), len(rows))
        return Reference(*(powers @ rows))


def _powers(s: float, count: int) -> Floats:
    """What the first `count` coefficients count for at `s`: in the value and in both derivatives."""
    value = [1.0] * count
    for power in range(1, count):
        value[power] = value[power - 1] * s
    first = [0.0] + [power * value[power - 1] for power in range(1, count)]
    second = [0.0] + [power * first[power - 1] for power in range(1, count)]
    return np.array([value, first, second])


def passed(path: Trajectory, t: float) -> int:
    """Index of the last point whose time has been reached at `t`; 0 before the second point."""
    return max(int(np.searchsorted(path.time, t, side="right")) - 1, 0)


def hold(position: Floats) -> Spline:
    """The curve that stays at `position` (n,): no segments, no duration."""
    return Spline(np.zeros(1), np.zeros((0, 2, len(position))), position.copy())


def knots(path: Trajectory, before: Reference) -> Knots:
    """What the curve of `path`, begun from `before` at t = 0, goes through; knot 0 is `before` if t₀ > 0."""
    columns = path.commanded
    first = path.time[0] > 0.0

    def rows(given: Floats | None, start: Floats, otherwise: Floats | float) -> Floats | None:
        if given is None:
            return None
        given = given if columns.all() else np.where(columns, given, otherwise)
        return np.concatenate([np.where(columns, start, otherwise)[None], given]) if first else given

    position = rows(path.position, before.position, before.position)
    assert position is not None  # given is not None
    return Knots(
        np.concatenate([[0.0], path.time]) if first else path.time,
        position,
        rows(path.velocity, before.velocity, 0.0),
        rows(path.acceleration, before.acceleration, 0.0) if path.velocity is not None else None,
    )


def interpolate(path: Trajectory, before: Reference) -> Spline:
    """The curve of `path`, begun from `before` at t = 0. Joints not commanded stay at `before.position`.

    A first point at t = 0 gives no segment from `before`: the jump is the gate's to judge (START_JUMP).
    """
    return curve(knots(path, before))


def curve(through: Knots) -> Spline:
    """The curve through `through`."""
    rows = _coefficients(through.time, through.position, through.velocity, through.acceleration)
    return Spline(through.time, rows, through.position[-1].copy())


def _coefficients(time: Floats, p: Floats, v: Floats | None, a: Floats | None) -> Floats:
    """Coefficients (s, degree + 1, n) of the segments between the knots (s + 1, n)."""
    T = np.diff(time)[:, None]
    h = np.diff(p, axis=0)
    if v is None:
        lines = np.empty((len(h), 2, p.shape[1]))
        lines[:, 0] = p[:-1]
        np.divide(h, T, out=lines[:, 1])
        return lines
    v0 = v[:-1]
    v1 = v[1:]
    if a is None:
        return np.stack([p[:-1], v0, (3 * h / T - 2 * v0 - v1) / T, (v0 + v1 - 2 * h / T) / T**2], axis=1)
    a0 = a[:-1]
    a1 = a[1:]
    return np.stack(
        [
            p[:-1],
            v0,
            a0 / 2,
            (20 * h - (8 * v1 + 12 * v0) * T - (3 * a0 - a1) * T**2) / (2 * T**3),
            (-30 * h + (14 * v1 + 16 * v0) * T + (3 * a0 - 2 * a1) * T**2) / (2 * T**4),
            (12 * h - 6 * (v0 + v1) * T + (a1 - a0) * T**2) / (2 * T**5),
        ],
        axis=1,
    )


def integrate(
    time: Floats,
    before: Reference,
    velocity: Floats | None = None,
    acceleration: Floats | None = None,
    position: Floats | None = None,
    commanded: Bools | None = None,
) -> Trajectory:
    """A path from velocities or accelerations (k, n), summed up from `before` by Heun's rule (trapezoid).

    NaN (and None) = not given at that point: what is missing follows from the derivative above it, and what
    is given is kept. Raises ValueError where a point has no way to a position, or time does not increase.
    """
    k = len(time)
    n = len(before.position)
    p, v, a = (
        np.full((k, n), np.nan) if given is None else given.copy()
        for given in (position, velocity, acceleration)
    )
    if k == 0 or not (time[0] >= 0.0 and np.all(np.diff(time) > 0.0)):
        raise ValueError("times must begin at 0 or later and increase")
    p0 = before.position
    v0 = np.nan_to_num(before.velocity)
    a0 = np.nan_to_num(before.acceleration)
    t0 = 0.0
    for i, t in enumerate(time):
        T = t - t0
        v[i] = np.where(np.isnan(v[i]), v0 + 0.5 * (a0 + a[i]) * T, v[i])
        p[i] = np.where(np.isnan(p[i]), p0 + 0.5 * (v0 + v[i]) * T, p[i])
        p0 = p[i]
        v0 = v[i]
        a0 = a[i]
        t0 = t
    chosen = np.ones(n, np.bool_) if commanded is None else commanded
    if not np.isfinite(p[:, chosen]).all():
        raise ValueError("a point gives neither position, velocity nor acceleration")
    known = [bool(np.isfinite(rows[:, chosen]).all()) for rows in (v, a)]
    return Trajectory(time, p, chosen, v if known[0] else None, a if all(known) else None)


def fill(time: Floats, position: Floats) -> Floats:
    """Velocities (k, n) that make the cubics through `position` twice differentiable, at rest at both ends.

    Raises ValueError with fewer than 2 points or times that do not increase.
    """
    if len(time) < 2 or not np.all(np.diff(time) > 0.0):
        raise ValueError("a smooth fill needs at least 2 points at increasing times")
    T = np.diff(time)[:, None]
    slope = np.diff(position, axis=0) / T
    velocity = np.zeros_like(position, np.float64)
    if len(time) == 2:
        return velocity
    # Row i: T[i+1] v[i] + 2 (T[i] + T[i+1]) v[i+1] + T[i] v[i+2] = 3 (T[i+1] slope[i] + T[i] slope[i+1])
    right = 3.0 * (T[1:] * slope[:-1] + T[:-1] * slope[1:])
    diagonal = 2.0 * (T[:-1] + T[1:])
    for i in range(1, len(right)):  # elimination; diagonally dominant, so without pivots
        factor = T[i + 1] / diagonal[i - 1]
        diagonal[i] = diagonal[i] - factor * T[i - 1]
        right[i] = right[i] - factor * right[i - 1]
    velocity[-2] = right[-1] / diagonal[-1]
    for i in range(len(right) - 2, -1, -1):
        velocity[i + 1] = (right[i] - T[i] * velocity[i + 2]) / diagonal[i]
    return velocity


def nearest_turn(current: Floats, following: Floats, mask: Bools) -> Floats:
    """`current` (n,), moved by whole turns to the place nearest `following` where `mask` says continuous."""
    turns = np.round((following - current) / (2.0 * np.pi))
    return np.where(mask, current + 2.0 * np.pi * turns, current)
