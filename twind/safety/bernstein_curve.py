"""Curves in Bernstein form: position and derivatives of segments, whose coefficients bound them."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from twind.robot.arrays import Floats, Ints
from twind.robot.joint_limits import JointLimits
from twind.robot.splines import Knots

Rows = tuple[Floats, ...]  # Bernstein coefficients of a stretch of segments, (s, m) each


@dataclass(frozen=True, slots=True)
class BernsteinCurve:
    """A stretch of segments in Bernstein form. Lines have no acceleration and no jerk."""

    position: Rows
    velocity: Rows
    acceleration: Rows
    jerk: Rows


@dataclass(frozen=True, slots=True)
class BoundedPolynomials:
    """Polynomials towards the upper limit, (degree + 1, q), with their bounds (q,)."""

    position: Floats
    velocity: Floats
    acceleration: Floats
    jerk: Floats
    upper: Floats
    hard: Floats
    fastest: Floats
    strongest: Floats


def pick(
    curve: BernsteinCurve, sign: float, segment: Ints, joint: Ints, limits: JointLimits
) -> BoundedPolynomials:
    """Return some segments (q,) and joints (q,) of `curve`; of its mirror image if `sign` is -1."""

    def of(rows: Rows) -> Floats:
        chosen = [sign * row[segment, joint] for row in rows]
        return np.stack(chosen) if chosen else np.empty((0, len(segment)))

    up = sign > 0.0
    return BoundedPolynomials(
        of(curve.position),
        of(curve.velocity),
        of(curve.acceleration),
        of(curve.jerk),
        (limits.upper if up else -limits.lower)[joint],
        (limits.hard_upper if up else -limits.hard_lower)[joint],
        limits.velocity[joint],
        limits.acceleration[joint],
    )


def smooth(knots: Knots, v: Floats, i: int, j: int) -> BernsteinCurve:
    """Return segments i..j-1 of cubics or quintics. Values given at the knots are kept exactly."""
    T = np.diff(knots.time[i : j + 1])[:, None]
    p0 = knots.position[i:j]
    p1 = knots.position[i + 1 : j + 1]
    v0 = v[i:j]
    v1 = v[i + 1 : j + 1]
    h = p1 - p0
    if knots.acceleration is None:
        middle = 3.0 * (h / T) - v0 - v1
        position = (p0, p0 + v0 * T / 3.0, p1 - v1 * T / 3.0, p1)
        velocity: Rows = (v0, middle, v1)
        acceleration: Rows = (2.0 * (middle - v0) / T, 2.0 * (v1 - middle) / T)
        return BernsteinCurve(position, velocity, acceleration, ((acceleration[1] - acceleration[0]) / T,))
    a0 = knots.acceleration[i:j]
    a1 = knots.acceleration[i + 1 : j + 1]
    early = v0 + a0 * T / 4.0
    late = v1 - a1 * T / 4.0
    middle = 5.0 * (h / T) - (v0 + early + late + v1)
    second = p0 + (2.0 * v0 + a0 * T / 4.0) * T / 5.0
    third = p1 - (2.0 * v1 - a1 * T / 4.0) * T / 5.0
    velocity = (v0, early, middle, late, v1)
    acceleration = (a0, 4.0 * (middle - early) / T, 4.0 * (late - middle) / T, a1)
    jerk = tuple(3.0 * (b - a) / T for a, b in pairwise(acceleration))
    return BernsteinCurve(
        (p0, p0 + v0 * T / 5.0, second, third, p1 - v1 * T / 5.0, p1), velocity, acceleration, jerk
    )
