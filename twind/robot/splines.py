"""Piecewise polynomials in time: the one curve that the gate judges and the executor follows.

Interpolation as `joint_trajectory_controller` does it: positions alone give lines, positions with velocities
cubics, with accelerations too quintics. The first segment runs from the state at arrival to the first point.
"""

from dataclasses import dataclass

import numpy as np

from twind.robot.arrays import Floats
from twind.robot.trajectory import Reference, Trajectory


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
        passed = int(np.searchsorted(self.time, t, side="right")) - 1
        return min(max(passed, 0), len(self.coefficients) - 1)

    def sample(self, t: float) -> Reference | None:
        """The reference at `t` s from start; None before it; at rest on `end` after the last knot."""
        if not t >= 0.0:
            return None
        if t >= self.time[-1] or not len(self.coefficients):
            still = np.zeros_like(self.end)
            return Reference(self.end, still, still)
        index = self.segment(t)
        s = t - self.time[index]
        rows = self.coefficients[index]
        position, velocity, acceleration = rows[-1].copy(), np.zeros_like(self.end), np.zeros_like(self.end)
        for row in rows[-2::-1]:  # Horner, with both derivatives
            acceleration = acceleration * s + 2.0 * velocity
            velocity = velocity * s + position
            position = position * s + row
        return Reference(position, velocity, acceleration)


def interpolate(path: Trajectory, before: Reference) -> Spline:
    """The curve of `path`, begun from `before` at t = 0. Joints not commanded stay at `before.position`.

    A first point at t = 0 gives no segment from `before`: the jump is the gate's to judge (S18).
    """
    columns = path.commanded
    position = np.where(columns, path.position, before.position)
    times, first = path.time, path.time[0] > 0.0

    def knots(given: Floats | None, start: Floats) -> Floats | None:
        if given is None:
            return None
        given = np.where(columns, given, 0.0)
        return np.vstack([np.where(columns, start, 0.0), given]) if first else given

    velocity = knots(path.velocity, before.velocity)
    acceleration = knots(path.acceleration, before.acceleration)
    if first:
        times = np.concatenate([[0.0], times])
        position = np.vstack([before.position, position])
    return Spline(times, _coefficients(times, position, velocity, acceleration), position[-1].copy())


def _coefficients(time: Floats, p: Floats, v: Floats | None, a: Floats | None) -> Floats:
    """Coefficients (s, degree + 1, n) of the segments between the knots (s + 1, n)."""
    T = np.diff(time)[:, None]
    h = np.diff(p, axis=0)
    if v is None:
        return np.stack([p[:-1], h / T], axis=1)
    v0, v1 = v[:-1], v[1:]
    if a is None:
        return np.stack([p[:-1], v0, (3 * h / T - 2 * v0 - v1) / T, (v0 + v1 - 2 * h / T) / T**2], axis=1)
    a0, a1 = a[:-1], a[1:]
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
