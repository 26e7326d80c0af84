"""The rules on a curve, on every point of it: position, velocity, acceleration, jerk, braking (S17, S19–S21).

Every rule is written once, for motion towards the upper limit, and applied a second time to the mirror
image. A quick look at the hull of each segment clears nearly all of them; what it cannot clear is decided
in `bounds`. Each joint is reported at its worst place.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from twind.robot.arrays import Bools, Floats, Ints
from twind.robot.finding import Code, Finding
from twind.robot.limits import Limits
from twind.robot.splines import Knots
from twind.safety.bounds import derivative, elevate, evaluate, exceeds, square, summit


@dataclass(frozen=True, slots=True)
class Thresholds:
    """The gate's numbers that do not depend on the joint (design 6.4). Settings may only tighten them."""

    latency_warn: float = 0.05  # s
    latency_block: float = 0.1  # s
    stale: float = 0.1  # s
    start_jump: float = 0.05  # rad, at t = 0
    jerk_warn: float = 5000.0  # rad/s³
    max_points: int = 2000
    max_duration: float = 60.0  # s
    min_dt: float = 0.001  # s
    brake_floor: float = 0.05  # rad/s, always allowed towards the limit
    brake_margin: float = 0.2  # rad/s, kept back from the fastest speed that can still stop
    end_velocity: float = 0.05  # rad/s, still counts as rest


@dataclass(frozen=True, slots=True)
class Spot:
    """The worst place of one joint by one rule. `score` orders spots of the same rule and joint."""

    finding: Finding
    score: float


@dataclass(frozen=True, slots=True)
class Subject:
    """A curve to judge: only the commanded joints, `joints` (m,) says which they are."""

    knots: Knots
    joints: Ints
    limits: Limits
    before: Floats  # rad/s, (m,), velocity of the reference
    offset: int  # knot index - point index: 1 where the curve begins at the reference


@dataclass(frozen=True, slots=True)
class Pieces:
    """Polynomials in Bernstein form, (degree + 1, ...) each, towards the upper limit, with their bounds."""

    position: Floats
    velocity: Floats
    acceleration: Floats
    jerk: Floats
    upper: Floats
    hard: Floats
    fastest: Floats
    strongest: Floats

    def columns(self, sign: float, segment: Ints, joint: Ints, limits: Limits) -> "Pieces":
        """Those of some segments and joints, (degree + 1, q); of the mirror image if `sign` is -1."""
        up = sign > 0.0
        return Pieces(
            sign * self.position[:, segment, joint],
            sign * self.velocity[:, segment, joint],
            sign * self.acceleration[:, segment, joint],
            sign * self.jerk[:, segment, joint],
            (limits.upper if up else -limits.lower)[joint],
            (limits.hard_upper if up else -limits.hard_lower)[joint],
            limits.velocity[joint],
            limits.acceleration[joint],
        )


def pieces(knots: Knots, i: int, j: int, limits: Limits) -> Pieces:
    """Segments i..j-1. What is given at the knots stands in the coefficients untouched, so ends are exact."""
    T = np.diff(knots.time[i : j + 1])[:, None]
    p0, p1 = knots.position[i:j], knots.position[i + 1 : j + 1]
    if knots.velocity is None:
        none = np.empty((0, *p0.shape))
        parts = (np.stack([p0, p1]), ((p1 - p0) / T)[None], none, none)
    else:
        v0, v1 = knots.velocity[i:j], knots.velocity[i + 1 : j + 1]
        if knots.acceleration is None:
            position = np.stack([p0, p0 + v0 * T / 3.0, p1 - v1 * T / 3.0, p1])
            velocity = np.stack([v0, 3.0 * ((p1 - p0) / T) - v0 - v1, v1])
            acceleration = derivative(velocity, T)
        else:
            a0, a1 = knots.acceleration[i:j], knots.acceleration[i + 1 : j + 1]
            early, late = v0 + a0 * T / 4.0, v1 - a1 * T / 4.0
            middle = 5.0 * ((p1 - p0) / T) - (v0 + early + late + v1)
            second, fourth = p0 + 2.0 * v0 * T / 5.0 + a0 * T**2 / 20.0, p1 - v1 * T / 5.0
            third = p1 - 2.0 * v1 * T / 5.0 + a1 * T**2 / 20.0
            position = np.stack([p0, p0 + v0 * T / 5.0, second, third, fourth, p1])
            velocity = np.stack([v0, early, middle, late, v1])
            acceleration = derivative(velocity, T)
            acceleration[0], acceleration[-1] = a0, a1
        parts = (position, velocity, acceleration, derivative(acceleration, T))
    return Pieces(*parts, limits.upper, limits.hard_upper, limits.velocity, limits.acceleration)


def judge(subject: Subject, i: int, j: int, limits: Limits, thresholds: Thresholds) -> list[Spot]:
    """Everything that segments i..j-1 do wrong, worst place per rule, direction and joint. Never raises."""
    with np.errstate(all="ignore"):  # NaN and overflow are answers here: they refuse
        spots = _corners(subject, i, j, thresholds) if subject.knots.velocity is None else []
        curve = pieces(subject.knots, i, j, limits)
        for code, sign, doubtful in _suspects(curve, limits, thresholds):
            if doubtful.any():
                segment, joint = np.nonzero(doubtful)
                columns = curve.columns(sign, segment, joint, limits)
                spots += _worst(subject, code, sign, columns, i + segment, joint, thresholds)
    return spots


def _suspects(curve: Pieces, limits: Limits, th: Thresholds) -> Iterator[tuple[Code, float, Bools]]:
    """Per rule and direction the segments and joints (s, m) whose hull does not already clear them."""
    low, high = curve.position.min(axis=0), curve.position.max(axis=0)
    back, forth = curve.velocity.min(axis=0), curve.velocity.max(axis=0)
    yield Code.POS_LIMIT, 1.0, ~(high <= limits.upper)
    yield Code.POS_LIMIT, -1.0, ~(low >= limits.lower)
    yield Code.VEL_LIMIT, 1.0, ~(forth <= limits.velocity)
    yield Code.VEL_LIMIT, -1.0, ~(back >= -limits.velocity)
    twice = 2.0 * limits.acceleration
    stop = (forth + th.brake_margin) ** 2 / twice + high <= limits.hard_upper
    yield Code.BRAKE_DISTANCE, 1.0, ~(stop | (forth <= th.brake_floor))
    stop = (th.brake_margin - back) ** 2 / twice - low <= -limits.hard_lower
    yield Code.BRAKE_DISTANCE, -1.0, ~(stop | (-back <= th.brake_floor))
    if len(curve.acceleration):
        yield Code.ACC_LIMIT, 1.0, ~(curve.acceleration.max(axis=0) <= limits.acceleration)
        yield Code.ACC_LIMIT, -1.0, ~(curve.acceleration.min(axis=0) >= -limits.acceleration)
        yield Code.JERK_LIMIT, 1.0, ~(curve.jerk.max(axis=0) <= th.jerk_warn)
        yield Code.JERK_LIMIT, -1.0, ~(curve.jerk.min(axis=0) >= -th.jerk_warn)


def _alternatives(code: Code, curve: Pieces, th: Thresholds) -> list[tuple[Floats, Floats]]:
    """The rule as polynomials and bounds, one of which must hold at every point."""
    if code is Code.POS_LIMIT:
        return [(curve.position, curve.upper)]
    if code is Code.VEL_LIMIT:
        return [(curve.velocity, curve.fastest)]
    if code is Code.ACC_LIMIT:
        return [(curve.acceleration, curve.strongest)]
    if code is Code.JERK_LIMIT:
        return [(curve.jerk, np.full(curve.jerk.shape[1], th.jerk_warn))]
    # v <= sqrt(2 a (hard - p)) - margin, written without the root: p + (v + margin)² / 2a <= hard.
    room = square(curve.velocity + th.brake_margin) / (2.0 * curve.strongest)
    degree = max(len(room), len(curve.position)) - 1
    reach = elevate(room, degree) + elevate(curve.position, degree)
    return [(curve.velocity, np.full_like(curve.hard, th.brake_floor)), (reach, curve.hard)]


def _reading(code: Code, curve: Pieces, columns: Ints, u: Floats, th: Thresholds) -> tuple[Floats, Floats]:
    """The rule's value and bound at the points `u` (q, r) of some columns (q,)."""

    def at(rows: Floats) -> Floats:
        return evaluate(rows[:, columns, None], u)

    def of(bound: Floats) -> Floats:
        return bound[columns, None] + 0.0 * u

    if code is Code.POS_LIMIT:
        return at(curve.position), of(curve.upper)
    if code is Code.VEL_LIMIT:
        return at(curve.velocity), of(curve.fastest)
    if code is Code.ACC_LIMIT:
        return at(curve.acceleration), of(curve.strongest)
    if code is Code.JERK_LIMIT:
        return at(curve.jerk), np.full_like(u, th.jerk_warn)
    left = np.maximum(of(curve.hard) - at(curve.position), 0.0)
    stoppable = np.sqrt(2.0 * of(curve.strongest) * left) - th.brake_margin
    return at(curve.velocity), np.maximum(stoppable, th.brake_floor)


def _worst(
    subject: Subject, code: Code, sign: float, curve: Pieces, segment: Ints, joint: Ints, th: Thresholds
) -> list[Spot]:
    """Decide the doubtful columns; of those that fail the worst place of each joint."""
    found = exceeds(_alternatives(code, curve, th))
    failing = np.flatnonzero(~np.isnan(found))

    def score(columns: Ints, u: Floats) -> Floats:
        value, bound = _reading(code, curve, failing[columns], u, th)
        return value - bound if code is Code.POS_LIMIT else value / bound

    column, u = summit(score, found[failing], joint[failing])
    value, bound = _reading(code, curve, failing[column], u[:, None], th)
    height = score(column, u[:, None])
    time = subject.knots.time
    spots = []
    for row, c in enumerate(failing[column]):
        s = int(segment[c])
        t = float(time[s] + u[row] * (time[s + 1] - time[s]))
        face = sign if code is Code.POS_LIMIT else 1.0  # a speed is reported by its size, a place by its side
        numbers = face * float(value[row, 0]), face * float(bound[row, 0])
        spots.append(_spot(subject, code, int(joint[c]), s + int(u[row] == 1.0), t, numbers, height[row, 0]))
    return spots


def _spot(
    subject: Subject, code: Code, joint: int, knot: int, t: float, numbers: tuple[float, float], score: float
) -> Spot:
    """A finding at a knot or after it, in the words of the path: joints of the robot, points of the path."""
    point = max(knot - subject.offset, 0)
    finding = Finding(code, int(subject.joints[joint]), point, t, value=numbers[0], bound=numbers[1])
    return Spot(finding, float(np.inf if np.isnan(score) else score))


def _corners(subject: Subject, i: int, j: int, th: Thresholds) -> list[Spot]:
    """Lines have no acceleration but at their corners: there it is the change of segment velocity over half
    the sum of the two durations (design 6.4), from the reference's velocity and, at the end, to rest."""
    time, position = subject.knots.time, subject.knots.position
    lo, hi = max(i - 1, 0), min(j + 1, len(time) - 1)
    T = np.diff(time[lo : hi + 1])[:, None]
    v = np.diff(position[lo : hi + 1], axis=0) / T
    if lo == i:
        T, v = np.vstack([[[0.0]], T]), np.vstack([subject.before, v])
    if hi == j:
        T, v = np.vstack([T, [[0.0]]]), np.vstack([v, np.zeros_like(subject.before)])
    change = np.diff(v, axis=0) / (0.5 * (T[1:] + T[:-1]))
    spots = _steepest(subject, Code.ACC_LIMIT, i, np.abs(change), subject.limits.acceleration)
    jerk = np.abs(np.diff(change, axis=0) / T[1:-1])
    return spots + _steepest(subject, Code.JERK_LIMIT, i, jerk, np.full(len(subject.joints), th.jerk_warn))


def _steepest(subject: Subject, code: Code, i: int, size: Floats, bound: Floats) -> list[Spot]:
    """The worst row of each joint whose `size` (rows from knot i on, m) is not within `bound` (m,)."""
    failing = np.flatnonzero(~(size <= bound).all(axis=0))
    spots = []
    for joint in failing:
        ratio = size[:, joint] / bound[joint]
        row = int(np.where(np.isnan(ratio), np.inf, ratio).argmax())
        numbers = float(size[row, joint]), float(bound[joint])
        spots.append(
            _spot(subject, code, int(joint), i + row, float(subject.knots.time[i + row]), numbers, ratio[row])
        )
    return spots


def start(subject: Subject, thresholds: Thresholds) -> list[Spot]:
    """A path that begins at t = 0 takes over the reference's velocity at once: is that step in bounds (S20)?

    The change counts over half of the first segment, as at the corner of two lines; where there is no segment
    it must be within what counts as rest. Lines are judged at their corners already.
    """
    knots, limits = subject.knots, subject.limits
    if subject.offset or (knots.velocity is None and len(knots.time) > 1):
        return []
    entry = np.zeros_like(subject.before) if knots.velocity is None else knots.velocity[0]
    with np.errstate(all="ignore"):
        step = np.abs(entry - subject.before)
        if len(knots.time) > 1:
            change = step / (0.5 * (knots.time[1] - knots.time[0]))
        else:
            change = np.where(step <= thresholds.end_velocity, 0.0, np.inf)
        return _steepest(subject, Code.ACC_LIMIT, 0, change[None], limits.acceleration)


def relaxed(subject: Subject) -> Limits | None:
    """For the segment that begins at a reference outside the limits: it may only come in, never go further
    out. None where the reference is inside, or the curve does not begin there."""
    position = subject.knots.position[0]
    if not subject.offset or bool(
        np.all((position >= subject.limits.lower) & (position <= subject.limits.upper))
    ):
        return None
    return replace(
        subject.limits,
        lower=np.minimum(subject.limits.lower, position),
        upper=np.maximum(subject.limits.upper, position),
    )


def some(limits: Limits, joints: Ints) -> Limits:
    """The limits of `joints` (indices) alone."""
    return Limits(
        limits.lower[joints],
        limits.upper[joints],
        limits.hard_lower[joints],
        limits.hard_upper[joints],
        limits.velocity[joints],
        limits.acceleration[joints],
        limits.effort[joints],
    )
