"""Rules on every point of a curve: POS_LIMIT, VEL_LIMIT, ACC_LIMIT, JERK_LIMIT, BRAKE_DISTANCE.

Every rule is written once, for motion towards the upper limit, and applied a second time to the mirror image.
The hull of each segment clears nearly all of them; the others are decided in `polynomial_bounds`. Each joint
is reported at its worst place.
"""

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from functools import reduce

import numpy as np

from twind.robot.arrays import Bools, Floats, Ints
from twind.robot.finding import Finding, ReasonCode
from twind.robot.joint_limits import JointLimits
from twind.robot.splines import Knots
from twind.safety.bernstein_curve import BernsteinCurve, BoundedPolynomials, Rows, pick, smooth
from twind.safety.gate_types import GateThresholds
from twind.safety.polynomial_bounds import elevate, evaluate, exceeds, square, summit


@dataclass(frozen=True, slots=True)
class WorstPoint:
    """Worst place of one joint by one rule. `score` orders places of the same rule and joint."""

    finding: Finding
    score: float


@dataclass(frozen=True, slots=True)
class JudgedCurve:
    """Curve to judge: only the commanded joints, `joints` (m,) gives their indices."""

    knots: Knots
    joints: Ints
    limits: JointLimits
    before: Floats  # rad/s, (m,), velocity of the reference
    offset: int  # knot index - point index: 1 where the curve begins at the reference


FEW = 8  # segments of a joint that are judged first


def judge(
    subject: JudgedCurve, i: int, j: int, limits: JointLimits, thresholds: GateThresholds
) -> list[WorstPoint]:
    """Return all faults of segments i..j-1, the worst place per rule, direction and joint. Never raises."""
    knots = subject.knots
    spots: list[WorstPoint] = []
    with np.errstate(all="ignore"):  # NaN and overflow are results here: they refuse
        if knots.velocity is None:
            T, slope = _slopes(subject, i, j)
            spots += _corners(subject, i, T, slope, thresholds)
            curve = BernsteinCurve(
                (knots.position[i:j], knots.position[i + 1 : j + 1]), (slope[1:-1],), (), ()
            )
        else:
            curve = smooth(knots, knots.velocity, i, j)
        for code, sign, hull, doubtful in _suspects(curve, limits, thresholds):
            for chosen in (_foremost(doubtful, hull), doubtful):
                # A path that is wrong everywhere must not cost more than one that is wrong once.
                segment, joint = np.nonzero(chosen)
                if len(segment):
                    pieces = pick(curve, sign, segment, joint, limits)
                    worst = _worst(subject, code, sign, pieces, i + segment, joint, thresholds)
                    doubtful[:, [joint for joint, _ in worst]] = False
                    spots += [spot for _, spot in worst]
                doubtful &= ~chosen
    return spots


def _foremost(doubtful: Bools, hull: Floats) -> Bools:
    """Select for each joint the few doubtful segments with the hulls that reach furthest.

    The worst point is nearly always there.
    """
    if np.count_nonzero(doubtful) <= FEW * hull.shape[1] or len(hull) <= FEW:
        return doubtful.copy()
    reach = np.where(doubtful, hull, -np.inf)
    chosen: Bools = doubtful & ~(reach < np.partition(reach, -FEW, axis=0)[-FEW])
    return chosen


def _span(rows: Rows) -> tuple[Floats, Floats]:
    """Return the hull of each segment: (s, m) lowest, highest."""
    return reduce(np.minimum, rows), reduce(np.maximum, rows)


def _suspects(
    curve: BernsteinCurve, limits: JointLimits, th: GateThresholds
) -> Iterator[tuple[ReasonCode, float, Floats, Bools]]:
    """Yield rules and directions that are not clear at once, with hulls and doubtful segments."""
    low, high = _span(curve.position)
    back, forth = _span(curve.velocity)
    hulls = [
        (ReasonCode.POS_LIMIT, 1.0, high, limits.upper),
        (ReasonCode.POS_LIMIT, -1.0, -low, -limits.lower),
        (ReasonCode.VEL_LIMIT, 1.0, forth, limits.velocity),
        (ReasonCode.VEL_LIMIT, -1.0, -back, limits.velocity),
    ]
    jerk = np.full_like(limits.upper, th.jerk_warn)
    for code, rows, bound in (
        (ReasonCode.ACC_LIMIT, curve.acceleration, limits.acceleration),
        (ReasonCode.JERK_LIMIT, curve.jerk, jerk),
    ):
        if rows:
            least, most = _span(rows)
            hulls += [(code, 1.0, most, bound), (code, -1.0, -least, bound)]
    for code, sign, hull, bound in hulls:
        clear = hull <= bound
        if not clear.all():
            yield code, sign, hull, ~clear
    twice = 2.0 * limits.acceleration
    for sign, speed, place, hard in (
        (1.0, forth, high, limits.hard_upper),
        (-1.0, -back, -low, -limits.hard_lower),
    ):
        stop = (speed + th.brake_margin) ** 2 / twice + place
        clear = (stop <= hard) | (speed <= th.brake_floor)
        if not clear.all():
            yield ReasonCode.BRAKE_DISTANCE, sign, stop, ~clear


def _alternatives(
    code: ReasonCode, curve: BoundedPolynomials, th: GateThresholds
) -> list[tuple[Floats, Floats]]:
    """Return the rule as polynomials and bounds, one of which must hold at every point."""
    if code is ReasonCode.POS_LIMIT:
        return [(curve.position, curve.upper)]
    if code is ReasonCode.VEL_LIMIT:
        return [(curve.velocity, curve.fastest)]
    if code is ReasonCode.ACC_LIMIT:
        return [(curve.acceleration, curve.strongest)]
    if code is ReasonCode.JERK_LIMIT:
        return [(curve.jerk, np.full(curve.jerk.shape[1], th.jerk_warn))]
    # v <= sqrt(2 a (hard - p)) - margin, written without the root: p + (v + margin)² / 2a <= hard.
    room = square(curve.velocity + th.brake_margin) / (2.0 * curve.strongest)
    degree = max(len(room), len(curve.position)) - 1
    reach = elevate(room, degree) + elevate(curve.position, degree)
    return [(curve.velocity, np.full_like(curve.hard, th.brake_floor)), (reach, curve.hard)]


def _reading(
    code: ReasonCode, curve: BoundedPolynomials, columns: Ints, u: Floats, th: GateThresholds
) -> tuple[Floats, Floats]:
    """Return the rule's value and bound at the points `u` (q, r) of some columns (q,)."""

    def at(rows: Floats) -> Floats:
        return evaluate(rows[:, columns, None], u)

    def of(bound: Floats) -> Floats:
        return bound[columns, None] + 0.0 * u

    if code is ReasonCode.POS_LIMIT:
        return at(curve.position), of(curve.upper)
    if code is ReasonCode.VEL_LIMIT:
        return at(curve.velocity), of(curve.fastest)
    if code is ReasonCode.ACC_LIMIT:
        return at(curve.acceleration), of(curve.strongest)
    if code is ReasonCode.JERK_LIMIT:
        return at(curve.jerk), np.full_like(u, th.jerk_warn)
    left = np.maximum(of(curve.hard) - at(curve.position), 0.0)
    stoppable = np.sqrt(2.0 * of(curve.strongest) * left) - th.brake_margin
    return at(curve.velocity), np.maximum(stoppable, th.brake_floor)


def _worst(
    subject: JudgedCurve,
    code: ReasonCode,
    sign: float,
    curve: BoundedPolynomials,
    segment: Ints,
    joint: Ints,
    th: GateThresholds,
) -> list[tuple[int, WorstPoint]]:
    """Decide the doubtful columns; return each failing joint (its column) and its worst place."""
    found = exceeds(_alternatives(code, curve, th))
    failing = np.flatnonzero(~np.isnan(found))
    if not len(failing):
        return []

    def score(columns: Ints, u: Floats) -> Floats:
        value, bound = _reading(code, curve, failing[columns], u, th)
        return value - bound if code is ReasonCode.POS_LIMIT else value / bound

    column, u = summit(score, found[failing], joint[failing])
    value, bound = _reading(code, curve, failing[column], u[:, None], th)
    height = score(column, u[:, None])
    time = subject.knots.time
    spots = []
    for row, c in enumerate(failing[column]):
        s = int(segment[c])
        t = float(time[s] + u[row] * (time[s + 1] - time[s]))
        face = (
            sign if code is ReasonCode.POS_LIMIT else 1.0
        )  # a speed is reported by its size, a place by its side
        numbers = face * float(value[row, 0]), face * float(bound[row, 0])
        knot = s + int(u[row] == 1.0)
        spot = _spot(subject, code, int(joint[c]), knot, t, numbers, height[row, 0])
        spots.append((int(joint[c]), spot))
    return spots


def _spot(
    subject: JudgedCurve,
    code: ReasonCode,
    joint: int,
    knot: int,
    t: float,
    numbers: tuple[float, float],
    score: float,
) -> WorstPoint:
    """Return a finding at a knot or after it, in joints of the robot and points of the path."""
    point = max(knot - subject.offset, 0)
    where = "on the way to this point" if knot < subject.offset and t > 0.0 else ""
    finding = Finding(code, int(subject.joints[joint]), point, t, numbers[0], numbers[1], where)
    return WorstPoint(finding, float(np.inf if np.isnan(score) else score))


def _slopes(subject: JudgedCurve, i: int, j: int) -> tuple[Floats, Floats]:
    """Return durations (s + 2, 1) and velocities (s + 2, m) of the lines i..j-1 with their neighbours.

    The first line follows the velocity of the reference, and rest follows the last one, each for 0 s.
    """
    time = subject.knots.time
    position = subject.knots.position
    T = np.zeros((j - i + 2, 1))
    slope = np.zeros((j - i + 2, position.shape[1]))
    lo = max(i - 1, 0)
    hi = min(j + 1, len(time) - 1)
    inner = slice(lo - i + 1, hi - i + 1)
    np.subtract(time[lo + 1 : hi + 1, None], time[lo:hi, None], out=T[inner])
    np.subtract(position[lo + 1 : hi + 1], position[lo:hi], out=slope[inner])
    slope[inner] /= T[inner]
    if lo == i:
        slope[0] = subject.before
    return T, slope


def _corners(subject: JudgedCurve, i: int, T: Floats, slope: Floats, th: GateThresholds) -> list[WorstPoint]:
    """Judge the corners of lines, which have acceleration nowhere else.

    It is the change of segment velocity over half the sum of the two durations. It begins at the reference's
    velocity and ends at rest.
    """
    change = slope[1:] - slope[:-1]
    change /= 0.5 * (T[1:] + T[:-1])
    jerk = change[1:] - change[:-1]
    jerk /= T[1:-1]
    spots = _steepest(subject, ReasonCode.ACC_LIMIT, i, change, subject.limits.acceleration)
    return spots + _steepest(
        subject, ReasonCode.JERK_LIMIT, i, jerk, np.full(len(subject.joints), th.jerk_warn)
    )


def _steepest(
    subject: JudgedCurve, code: ReasonCode, i: int, change: Floats, bound: Floats
) -> list[WorstPoint]:
    """Return the worst row of each joint whose size (rows from knot i on, m) is not within `bound` (m,)."""
    within = np.abs(change) <= bound
    if within.all():
        return []
    spots = []
    for joint in np.flatnonzero(~within.all(axis=0)):
        size = np.abs(change[:, joint])
        row = int(np.where(np.isnan(size), np.inf, size).argmax())
        numbers = float(size[row]), float(bound[joint])
        t = float(subject.knots.time[i + row])
        spots.append(_spot(subject, code, int(joint), i + row, t, numbers, numbers[0] / bound[joint]))
    return spots


def start(subject: JudgedCurve, thresholds: GateThresholds) -> list[WorstPoint]:
    """Check the velocity step of a path that begins at t = 0 against the reference (ACC_LIMIT).

    The change counts over half of the first segment, as at the corner of two lines; where there is no segment
    it must be within what counts as rest. Lines are judged at their corners already.
    """
    knots = subject.knots
    limits = subject.limits
    if subject.offset or (knots.velocity is None and len(knots.time) > 1):
        return []
    entry = np.zeros_like(subject.before) if knots.velocity is None else knots.velocity[0]
    with np.errstate(all="ignore"):
        step = np.abs(entry - subject.before)
        if len(knots.time) > 1:
            change = step / (0.5 * (knots.time[1] - knots.time[0]))
        else:
            change = np.where(step <= thresholds.end_velocity, 0.0, np.inf)
        return _steepest(subject, ReasonCode.ACC_LIMIT, 0, change[None, :], limits.acceleration)


def relaxed(subject: JudgedCurve) -> JointLimits | None:
    """Return wider limits for a segment that begins at a reference outside of them; None: it does not.

    The segment may only lead inwards, never further out.
    """
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


def resting(subject: JudgedCurve) -> JudgedCurve:
    """Return the last point, held for a second."""
    time = subject.knots.time[-1:]
    position = np.repeat(subject.knots.position[-1:], 2, axis=0)
    still = Knots(np.append(time, time + 1.0), position, None, None)
    last = len(subject.knots.time) - 1 - subject.offset
    return replace(subject, knots=still, before=np.zeros_like(subject.before), offset=-last)


def some(limits: JointLimits, joints: Ints) -> JointLimits:
    """Return the limits of `joints` (indices) alone."""
    return JointLimits(*(getattr(limits, field.name)[joints] for field in fields(limits)))
