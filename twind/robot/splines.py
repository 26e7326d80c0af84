"""Piecewise polynomials in time: the curve that the gate judges and the executor follows.

Interpolation as in `joint_trajectory_controller`: positions alone give lines, positions with velocities
cubics, with accelerations too quintics. The first segment runs from the state at arrival to the first point.
"""

from dataclasses import dataclass, field

import numpy as np

from twind.robot.arrays import Floats
from twind.robot.trajectory import Reference, Trajectory


@dataclass(frozen=True, slots=True)
class Knots:
    """Points that a curve passes through. Arrays (k, n); velocity and acceleration as the path gives them."""

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
    duration: float = field(init=False)  # s, time of the last knot

    def __post_init__(self) -> None:
        object.__setattr__(self, "duration", float(self.time[-1]))

    def segment(self, t: float) -> int:
        """Index of the segment that `t` falls in; the last one at and after the end."""
        passed = int(self.time.searchsorted(t, side="right")) - 1
        return min(max(passed, 0), len(self.coefficients) - 1)

    def sample(self, t: float) -> Reference | None:
        """Return the reference at `t` s from start; None before it; at rest on `end` after the last knot."""
        if not t >= 0.0:
            return None
        if t >= self.duration or not len(self.coefficients):
            still = np.zeros_like(self.end)
            return Reference(self.end, still, still)
        return self.inside(self.segment(t), t)

    def inside(self, index: int, t: float) -> Reference:
        """Return the polynomial of segment `index` at `t` s from start; at a knot the limit from its side."""
        rows = self.coefficients[index]
        powers = _powers(t - float(self.time[index]), len(rows))
        return Reference(*(powers @ rows))


def _powers(s: float, count: int) -> Floats:
    """Return the factors (3, count) of the coefficients at `s`, for value and both derivatives."""
    value = [1.0] * count
    for power in range(1, count):
        value[power] = value[power - 1] * s
    first = [0.0] + [power * value[power - 1] for power in range(1, count)]
    second = [0.0] + [power * first[power - 1] for power in range(1, count)]
    return np.array([value, first, second])


def passed(path: Trajectory, t: float) -> int:
    """Return the index of the last point whose time has been reached at `t`; 0 before the second point."""
    return max(int(np.searchsorted(path.time, t, side="right")) - 1, 0)


def hold(position: Floats) -> Spline:
    """Return the curve that stays at `position` (n,): no segments, no duration."""
    return Spline(np.zeros(1), np.zeros((0, 2, len(position))), position.copy())


def knots(path: Trajectory, before: Reference) -> Knots:
    """Return the knots of `path`, begun from `before` at t = 0; knot 0 is `before` if t₀ > 0."""
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
    """Return the curve of `path`, begun from `before` at t = 0.

    Joints not commanded stay at `before.position`.

    A first point at t = 0 gives no segment from `before`: START_JUMP judges the jump.
    """
    return curve(knots(path, before))


def curve(through: Knots) -> Spline:
    """Return the curve through the knots `through`."""
    rows = _coefficients(through.time, through.position, through.velocity, through.acceleration)
    return Spline(through.time, rows, through.position[-1].copy())


def _coefficients(time: Floats, p: Floats, v: Floats | None, a: Floats | None) -> Floats:
    """Return the coefficients (s, degree + 1, n) of the segments between the knots (s + 1, n)."""
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
