"""The oracle: a trajectory looked at in very many places. Knows docs/safety.md and nothing of `twind.safety`.

Each segment's polynomial is solved in rationals from its end conditions (`gate_world.oracle_segments`) and
looked at in `SAMPLES` places and at its peaks; some paths are judged in rationals altogether
(`oracle_faults`). What comes back is how far each rule is from its bound, so that the same look serves both
ways: above 0 is a violation, below 0 is none.
"""

from math import inf

import numpy as np

from tests.support import gate_rig as w
from twind.robot.arrays import Floats
from twind.robot.finding import ReasonCode
from twind.robot.joint_limits import JointLimits
from twind.robot.trajectory import Reference, Trajectory

SAMPLES = 401  # of a segment
START_JUMP = 0.05  # rad
END_VELOCITY = 0.05  # rad/s
# rad/s, of the braking rule
FLOOR = 0.05
KEPT_BACK = 0.2
# s
LONGEST = 60.0
SHORTEST = 0.001

Excess = dict[ReasonCode, float]


def excess(path: Trajectory, before: Reference, limit: JointLimits) -> Excess:
    """By how much each rule is broken at its worst place, in its unit; negative: the room that is left."""
    worst = dict.fromkeys(
        (
            ReasonCode.POS_LIMIT,
            ReasonCode.START_JUMP,
            ReasonCode.VEL_LIMIT,
            ReasonCode.ACC_LIMIT,
            ReasonCode.BRAKE_DISTANCE,
            ReasonCode.END_NOT_AT_REST,
            ReasonCode.TIME_ORDER,
            ReasonCode.TOO_MANY_POINTS,
        ),
        -inf,
    )

    def see(code: ReasonCode, amount: float) -> None:
        worst[code] = max(worst[code], inf if np.isnan(amount) else float(amount))

    steps = np.diff(path.time, prepend=0.0)
    see(ReasonCode.TIME_ORDER, SHORTEST - np.min(steps[1:] if path.time[0] == 0.0 else steps, initial=inf))
    see(ReasonCode.TOO_MANY_POINTS, path.time[-1] - LONGEST)
    for joint in np.flatnonzero(path.commanded):
        _ends(see, path, before, limit, int(joint))
        _between(see, path, before, limit, int(joint))
    return worst


def _ends(see, path: Trajectory, before: Reference, limit: JointLimits, joint: int) -> None:
    """POS_LIMIT at the points, START_JUMP, END_NOT_AT_REST, and the first instant of ACC_LIMIT."""
    place = path.position[:, joint]
    low = limit.lower[joint]
    high = limit.upper[joint]
    see(ReasonCode.POS_LIMIT, max(np.max(place - high), np.max(low - place)))
    jump = abs(place[0] - before.position[joint])
    see(ReasonCode.START_JUMP, jump - START_JUMP - limit.velocity[joint] * path.time[0])
    if path.velocity is not None:
        see(ReasonCode.END_NOT_AT_REST, abs(path.velocity[-1, joint]) - END_VELOCITY)
    if path.time[0] == 0.0:  # the reference's velocity gives way to the path's at once
        entry = 0.0 if path.velocity is None else path.velocity[0, joint]
        step = abs(entry - before.velocity[joint])
        if len(path.time) == 1:
            see(ReasonCode.ACC_LIMIT, step - END_VELOCITY)
        elif path.velocity is not None:
            see(ReasonCode.ACC_LIMIT, step / (0.5 * path.time[1]) - limit.acceleration[joint])


def _between(see, path: Trajectory, before: Reference, limit: JointLimits, joint: int) -> None:
    """POS_LIMIT, VEL_LIMIT to BRAKE_DISTANCE along the curve."""
    segments = w.oracle_segments(path, before, joint)
    strongest = float(limit.acceleration[joint])
    slopes = [float(before.velocity[joint])]
    spans = [0.0]
    for index, (T, exact) in enumerate(segments):
        duration = float(T)
        ascending = [float(c) for c in exact]
        p, v, a = _sampled(ascending, duration)
        low = float(limit.lower[joint])
        high = float(limit.upper[joint])
        if index == 0 and path.time[0] > 0.0:  # from outside it may come in
            low = min(low, p[0])
            high = max(high, p[0])
        see(ReasonCode.POS_LIMIT, max(p.max() - high, low - p.min()))
        see(ReasonCode.VEL_LIMIT, np.abs(v).max() - float(limit.velocity[joint]))
        see(ReasonCode.ACC_LIMIT, np.abs(a).max() - strongest)
        for speed, left in ((v, limit.hard_upper[joint] - p), (-v, p - limit.hard_lower[joint])):
            stoppable = np.sqrt(2.0 * strongest * np.maximum(left, 0.0)) - KEPT_BACK
            see(ReasonCode.BRAKE_DISTANCE, np.max(speed - np.maximum(stoppable, FLOOR)))
        slopes.append(ascending[1])
        spans.append(duration)
    if path.velocity is None and segments:
        change = np.abs(np.diff([*slopes, 0.0])) / (0.5 * (np.array(spans) + np.array([*spans[1:], 0.0])))
        see(ReasonCode.ACC_LIMIT, change.max() - strongest)


def _sampled(ascending: list[float], duration: float) -> tuple[Floats, Floats, Floats]:
    """Place, speed and acceleration at evenly spread times, and wherever one of them may have a peak."""
    curve = np.polynomial.Polynomial(ascending)
    curves = curve, curve.deriv(1), curve.deriv(2)
    peaks = np.concatenate([np.empty(0), *(each.deriv(1).roots() for each in curves if each.degree() > 1)])
    peaks = np.real(peaks[np.abs(np.imag(peaks)) < 1e-9])
    s = np.append(np.linspace(0.0, duration, SAMPLES), peaks[(peaks > 0.0) & (peaks < duration)])
    return curve(s), curves[1](s), curves[2](s)
