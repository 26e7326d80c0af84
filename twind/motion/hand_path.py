"""Path of a hand at the joints, and its simplification to few points of a trajectory. Pure.

The simplification is Ramer-Douglas-Peucker with a cubic in place of the chord: a segment whose samples are
further than a bound from its cubic is split at the furthest one. Distances are taken at equal time. A path
that is too fast somewhere gets later times there: the samples, and so the way, stay the same.
"""

from dataclasses import dataclass
from math import perm
from typing import Literal, NamedTuple

import numpy as np

from twind.robot import splines
from twind.robot.arrays import Bools, Floats
from twind.robot.splines import Knots, Spline

WINDOW = 0.08  # s, each side of a sample: its speed is the slope of a line through the samples within
# s of a ramp to rest where the hand was moving at an end, and rad/s that still count as rest
RAMP = 0.3
REST = 0.05
BLEND = 0.3  # s, over which a path slows down before a place that is too fast, and returns to its speed


@dataclass(frozen=True, slots=True)
class HandPath:
    """Samples of m joints, at least two. Arrays (k,) s, strictly increasing, and (k, m) rad."""

    time: Floats
    position: Floats

    def clipped(self, lower: Floats, upper: Floats) -> "HandPath":
        """Return the path with every joint within `lower` and `upper` (m,), rad."""
        return HandPath(self.time, np.clip(self.position, lower, upper))

    def slowed(self, pace: Floats) -> "HandPath":
        """Return the path with the steps around each sample `pace` (k,) times as long, blended over BLEND."""
        blended = _blended(self.time, pace)
        steps = np.diff(self.time) * np.maximum(blended[1:], blended[:-1])
        return HandPath(self.time[0] + np.concatenate([[0.0], np.cumsum(steps)]), self.position)


class Deviation(NamedTuple):
    """Largest distance of a curve from a hand's path at equal time."""

    size: float  # rad
    joint: int
    time: float  # s, from the first sample


def simplify(path: HandPath, bound: float) -> Knots:
    """Return points whose cubics come within `bound` (rad) of every sample; they begin and end at rest.

    The first and the last sample are among them, and their time counts from the first. A ramp of RAMP leads
    to rest where the hand was moving: then time begins at -RAMP.
    """
    time = path.time - path.time[0]
    velocity = _slopes(time, path.position)
    moving = _settle_ends(velocity)
    chosen = _chosen(Knots(time, path.position, velocity, None), bound)
    rows = (time[chosen], path.position[chosen], velocity[chosen])
    return Knots(*_ramped(*rows, moving), None)


def excess(points: Knots, path: HandPath, velocity: Floats, acceleration: Floats) -> Floats:
    """Return the pace (k,), at least 1, at which the curve keeps these limits (m,) at each sample."""
    curve = splines.curve(points)
    time = path.time - path.time[0]
    speed = np.abs(_values(curve, time, 1)) / velocity
    push = np.abs(np.stack([_values(curve, time, 2, side) for side in ("left", "right")])).max(axis=0)
    pace: Floats = np.maximum(speed, np.sqrt(push / acceleration)).max(axis=1)
    return np.maximum(pace, 1.0)


def deviation(points: Knots, path: HandPath) -> Deviation:
    """Return the largest distance of the curve through `points` from the samples of `path`."""
    time = path.time - path.time[0]
    far = np.abs(_values(splines.curve(points), time) - path.position)
    sample, joint = np.unravel_index(int(far.argmax()), far.shape)
    return Deviation(float(far[sample, joint]), int(joint), float(time[sample]))


def _slopes(time: Floats, position: Floats) -> Floats:
    """Return the speed at each sample (k, m): least squares over WINDOW, at least the two neighbours."""
    place = np.arange(len(time))
    first = np.minimum(np.searchsorted(time, time - WINDOW), np.maximum(place - 1, 0))
    last = np.maximum(np.searchsorted(time, time + WINDOW, side="right"), np.minimum(place + 2, len(time)))
    # Sums are taken about the middle of the samples, since they lose digits otherwise.
    t = time - time.mean()
    q = position - position.mean(axis=0)
    sums = [_running(each) for each in (t[:, None], q, t[:, None] * q, (t * t)[:, None])]
    st, sq, stq, stt = (each[last] - each[first] for each in sums)
    count = (last - first)[:, None]
    slopes: Floats = (stq - st * sq / count) / (stt - st * st / count)
    return slopes


def _running(rows: Floats) -> Floats:
    """Return the sums (k + 1, m) of the first 0, 1, … k rows."""
    return np.concatenate([np.zeros((1, rows.shape[1])), np.cumsum(rows, axis=0)])


def _settle_ends(velocity: Floats) -> tuple[bool, bool]:
    """Return whether the hand was moving at the first and the last sample; where not, set the speed to 0."""
    moving = []
    for end in (0, -1):
        moving.append(bool((np.abs(velocity[end]) > REST).any()))
        if not moving[-1]:
            velocity[end] = 0.0
    return moving[0], moving[1]


def _ramped(
    time: Floats, position: Floats, velocity: Floats, moving: tuple[bool, bool]
) -> tuple[Floats, Floats, Floats]:
    """Return points with a ramp of constant acceleration at each end where the hand was moving."""
    still = np.zeros((1, position.shape[1]))
    if moving[0]:
        time = np.append(time[0] - RAMP, time)
        position = np.vstack([position[0] - 0.5 * RAMP * velocity[0], position])
        velocity = np.vstack([still, velocity])
    if moving[1]:
        time = np.append(time, time[-1] + RAMP)
        position = np.vstack([position, position[-1] + 0.5 * RAMP * velocity[-1]])
        velocity = np.vstack([velocity, still])
    return time, position, velocity


def _chosen(samples: Knots, bound: float) -> Bools:
    """Select the samples (k,) whose cubics are within `bound` of all others."""
    kept = np.zeros(len(samples.time), np.bool_)
    kept[[0, -1]] = True
    pending = [(0, len(kept) - 1)]
    while pending:
        first, last = pending.pop()
        between = slice(first + 1, last)
        if last - first < 2:
            continue
        curve = splines.curve(_pick(samples, [first, last]))
        far = np.abs(_values(curve, samples.time[between]) - samples.position[between]).max(axis=1)
        worst = int(far.argmax())
        if not far[worst] <= bound:
            split = first + 1 + worst
            kept[split] = True
            pending += [(first, split), (split, last)]
    return kept


def _pick(samples: Knots, rows: list[int]) -> Knots:
    velocity = None if samples.velocity is None else samples.velocity[rows]
    return Knots(samples.time[rows], samples.position[rows], velocity, None)


def _values(
    curve: Spline, time: Floats, derivative: int = 0, side: Literal["left", "right"] = "right"
) -> Floats:
    """Return positions (k, m) of a curve at times (k,), or a derivative. `side`: its side of a knot."""
    segment = np.clip(np.searchsorted(curve.time, time, side=side) - 1, 0, len(curve.coefficients) - 1)
    local = (time - curve.time[segment])[:, None]
    rows = curve.coefficients[segment]
    found = np.zeros_like(rows[:, 0])
    for power in range(rows.shape[1] - 1, derivative - 1, -1):
        found = found * local + perm(power, derivative) * rows[:, power]
    return found


def _blended(time: Floats, pace: Floats) -> Floats:
    """Return `pace` with every value above 1 spread to its neighbours, falling to 1 within BLEND."""
    spread = pace.copy()
    for fast in np.flatnonzero(pace > 1.0):
        near = slice(*np.searchsorted(time, (time[fast] - BLEND, time[fast] + BLEND)))
        share = np.cos(0.5 * np.pi * (time[near] - time[fast]) / BLEND) ** 2
        spread[near] = np.maximum(spread[near], 1.0 + share * (pace[fast] - 1.0))
    return spread
