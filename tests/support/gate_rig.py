"""Rig of the gate's tests: robots, snapshots, paths, and an oracle that is slow and exact.

The oracle knows nothing of `twind.safety`: it solves each segment's polynomial from its end conditions in
rationals and looks at it in many places.
"""

from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from math import comb, inf, nan

import numpy as np
from hypothesis import strategies as st

from twind.robot.actuator_ratings import ActuatorRatings
from twind.robot.arrays import Floats
from twind.robot.finding import ReasonCode
from twind.robot.joint_limits import JointLimits
from twind.robot.modes import Mode, Motion, RobotState
from twind.robot.trajectory import Reference, Trajectory
from twind.safety.gate import GateResult, GateSnapshot, GateThresholds, TrajectoryRequest, check
from twind.safety.headroom import JointCondition

TH = GateThresholds()
CAREFUL = Fraction(1, 10**11)  # rounding of the product's doubles; the oracle itself has none
REST = Fraction(0.05)  # rad/s, counts as rest (docs/reason-codes.md)


def limits(n: int = 2, **over: float | Floats) -> JointLimits:
    """Equal limits for n joints: ±2 rad, hard ±2.05, 4 rad/s, 20 rad/s²."""
    values = {"lower": -2.0, "upper": 2.0, "velocity": 4.0, "acceleration": 20.0, "effort": np.nan} | over
    values = {"hard_lower": values["lower"] - 0.05, "hard_upper": values["upper"] + 0.05} | values
    return JointLimits(
        **{name: np.broadcast_to(np.float64(value), n).copy() for name, value in values.items()}
    )


def at_rest(position: list[float] | Floats) -> Reference:
    position = np.array(position, np.float64)
    return Reference(position, np.zeros_like(position), np.zeros_like(position))


def snapshot(n: int = 2, mode: Mode = Mode.LIVE, **over: object) -> GateSnapshot:
    """Armed, holding at zero, all well."""
    state = RobotState.ARMED if mode is Mode.LIVE else RobotState.DISCONNECTED
    usual = GateSnapshot(
        now=5.0,
        mode=mode,
        state=state,
        motion=Motion.HOLDING,
        latched=(),
        lease_held=True,
        mismatches=(),
        calibrated=np.ones(n, np.bool_),
        age=np.full(n, 0.004),
        latency=0.006,
        latency_p95=0.007,
        reference=at_rest(np.zeros(n)),
        period=0.01,
        condition=condition(n),
    )
    return replace(usual, **over)


def ratings(n: int = 2) -> ActuatorRatings:
    """Ratings of XM430s at 12 V."""
    bounds = {"low_warn": 11.1, "low_settle": 10.5, "low_fault": 10.0, "high_warn": 14.8}
    bounds |= {"lead": inf, "stiffness": nan, "lag": nan}  # they have a watchdog
    bounds |= {"follow": nan, "follow_for": nan}
    bounds |= {"warm": 60.0, "hot": 65.0, "shut": 70.0, "cool": 55.0, "continuous": 0.5}
    return ActuatorRatings(
        **{name: np.full(n, bound) for name, bound in bounds.items()}, leg=np.zeros(n, np.bool_)
    )


def condition(n: int = 2, **over: object) -> JointCondition:
    """Cool, with a full battery, read just now."""
    return replace(JointCondition(np.full(n, 35.0), np.full(n, 12.0), np.full(n, 0.1), ratings(n)), **over)


def path(time: list[float], position: list, velocity: list | None = None, acceleration: list | None = None):
    """A path of all joints; a row may be a number where there is one joint."""
    rows = [
        None if given is None else np.array(given, np.float64) for given in (position, velocity, acceleration)
    ]
    rows = [None if given is None else given.reshape(len(time), -1) for given in rows]
    commanded = np.ones(rows[0].shape[1], np.bool_)
    return Trajectory(np.array(time, np.float64), rows[0], commanded, rows[1], rows[2])


def ask(
    given: Trajectory,
    limit: JointLimits,
    before: Reference | None = None,
    demand: TrajectoryRequest | None = None,
) -> GateResult:
    """The verdict of an armed robot that holds at `before` (the path's first point where not said)."""
    n = given.position.shape[1]
    before = at_rest(given.position[0]) if before is None else before
    return check(given, snapshot(n, reference=before), limit, demand or TrajectoryRequest(), TH)


def codes(judged: GateResult) -> set[ReasonCode]:
    return {finding.code for finding in judged.verdict.refusals}


# ------------------------------------------------------------------------------------------ the oracle


def oracle_segments(
    given: Trajectory, before: Reference, joint: int
) -> list[tuple[Fraction, list[Fraction]]]:
    """(duration, ascending coefficients in local time) of each segment of one joint, exactly."""

    def state(i: int) -> list[Fraction]:
        rows = (given.position, given.velocity, given.acceleration)
        return [Fraction(float(row[i, joint])) for row in rows if row is not None]

    times = [Fraction(float(t)) for t in given.time]
    states = [state(i) for i in range(len(times))]
    if times[0] > 0:
        reference = (before.position, before.velocity, before.acceleration)
        first = [Fraction(float(row[joint])) for row in reference][: len(states[0])]
        times = [Fraction(0), *times]
        states = [first, *states]
    return [
        (t1 - t0, _hermite(t1 - t0, a, b))
        for t0, t1, a, b in zip(times, times[1:], states, states[1:], strict=False)
    ]


def _hermite(T: Fraction, start: list[Fraction], end: list[Fraction]) -> list[Fraction]:
    """The polynomial with these derivatives at 0 and T: the low half is given, the high half solved for."""
    m = len(start)
    low = [value / _factorial(i) for i, value in enumerate(start)]
    table = []
    right = []
    for d in range(m):  # d-th derivative at T
        known = sum(low[i] * _falling(i, d) * T ** (i - d) for i in range(d, m))
        right.append(end[d] - known)
        table.append([_falling(i, d) * T ** (i - d) for i in range(m, 2 * m)])
    return low + _solve(table, right)


def _factorial(i: int) -> int:
    return 1 if i < 2 else i * _factorial(i - 1)


def _falling(i: int, d: int) -> Fraction:
    return Fraction(comb(i, d) * _factorial(d))


def _solve(table: list[list[Fraction]], right: list[Fraction]) -> list[Fraction]:
    """Gauss, in rationals."""
    n = len(right)
    rows = [[*row, value] for row, value in zip(table, right, strict=True)]
    for i in range(n):
        pivot = next(r for r in range(i, n) if rows[r][i] != 0)
        rows[i], rows[pivot] = rows[pivot], rows[i]
        rows[i] = [value / rows[i][i] for value in rows[i]]
        for r in range(n):
            if r != i:
                rows[r] = [a - rows[r][i] * b for a, b in zip(rows[r], rows[i], strict=True)]
    return [row[-1] for row in rows]


def value_at(coefficients: list[Fraction], s: Fraction, d: int = 0) -> Fraction:
    return sum(
        (c * _falling(i, d) * s ** (i - d) for i, c in enumerate(coefficients) if i >= d), start=Fraction(0)
    )


def oracle_faults(
    given: Trajectory, before: Reference, limit: JointLimits, samples: int = 16
) -> set[ReasonCode]:
    """The rules of the curve that the oracle sees broken by more than rounding, in any commanded joint."""
    faults: set[ReasonCode] = set()
    for joint in np.flatnonzero(given.commanded):
        bound = [
            Fraction(float(row[joint]))
            for row in (limit.lower, limit.upper, limit.velocity, limit.acceleration)
        ]
        lower, upper, fastest, strongest = bound
        hard = Fraction(float(limit.hard_lower[joint])), Fraction(float(limit.hard_upper[joint]))
        segments = oracle_segments(given, before, int(joint))
        for index, (T, coefficients) in enumerate(segments):
            if index == 0 and given.time[0] > 0:  # from outside it may come in
                low = min(lower, coefficients[0])
                high = max(upper, coefficients[0])
            else:
                low = lower
                high = upper
            for k in range(samples + 1):
                s = T * k / samples
                p, v, a = (value_at(coefficients, s, d) for d in range(3))
                if not low - CAREFUL <= p <= high + CAREFUL:
                    faults.add(ReasonCode.POS_LIMIT)
                if abs(v) > fastest * (1 + CAREFUL) + CAREFUL:
                    faults.add(ReasonCode.VEL_LIMIT)
                if abs(a) > strongest * (1 + CAREFUL) + CAREFUL * 10**3:
                    faults.add(ReasonCode.ACC_LIMIT)
                if not _stops(p, v, hard, strongest):
                    faults.add(ReasonCode.BRAKE_DISTANCE)
        if any(not lower <= Fraction(float(p)) <= upper for p in given.position[:, joint]):
            faults.add(ReasonCode.POS_LIMIT)
        speed = Fraction(float(before.velocity[joint]))
        if given.time[0] == 0.0 and (len(given.time) == 1 or given.velocity is not None):
            faults |= _entry_faults(given, speed, int(joint), strongest)
        elif given.velocity is None:
            faults |= _corner_faults(segments, speed, strongest)
    return faults


def _stops(p: Fraction, v: Fraction, hard: tuple[Fraction, Fraction], a: Fraction) -> bool:
    """|v| <= max(0.05, sqrt(2 a d) - 0.2), without a root."""
    speed, d = (v, hard[1] - p) if v > 0 else (-v, p - hard[0])
    if speed <= Fraction(0.05) + CAREFUL:  # the floor, always allowed
        return True
    return (speed + Fraction(0.2)) ** 2 <= 2 * a * d + CAREFUL * 100


def _entry_faults(given: Trajectory, before: Fraction, joint: int, strongest: Fraction) -> set[ReasonCode]:
    """ACC_LIMIT at t = 0: the reference's speed changes to the path's over half of the first segment.

    Where there is none, it has no time at all: the change must be within what counts as rest.
    """
    entry = Fraction(0) if given.velocity is None else Fraction(float(given.velocity[0, joint]))
    change = abs(entry - before)
    most = REST
    if len(given.time) > 1:
        most = strongest * (Fraction(float(given.time[1])) - Fraction(float(given.time[0]))) / 2
    return {ReasonCode.ACC_LIMIT} if change > most * (1 + CAREFUL) + CAREFUL else set()


def _corner_faults(
    segments: list[tuple[Fraction, list[Fraction]]], before: Fraction, strongest: Fraction
) -> set[ReasonCode]:
    slopes = [before, *(coefficients[1] for _, coefficients in segments), Fraction(0)]
    spans = [Fraction(0), *(T for T, _ in segments), Fraction(0)]
    for i in range(len(slopes) - 1):
        change = abs(slopes[i + 1] - slopes[i])
        if change > strongest * (spans[i] + spans[i + 1]) / 2 * (1 + CAREFUL) + CAREFUL:
            return {ReasonCode.ACC_LIMIT}
    return set()


# ------------------------------------------------------------------------------------------ strategies

GENTLE = st.floats(-1.9, 1.9, allow_subnormal=False)


@st.composite
def paths(draw: Callable, joints: int = 2, most: int = 5, at_zero: bool | None = None) -> Trajectory:
    """Finite paths that are sometimes fine and sometimes not; of all three degrees."""
    k = draw(st.integers(1, most))
    steps = draw(st.lists(st.floats(0.02, 1.5), min_size=k, max_size=k))
    time = np.cumsum(steps)
    if draw(st.booleans()) if at_zero is None else at_zero:
        time -= time[0]
    block = st.lists(GENTLE, min_size=k * joints, max_size=k * joints)
    size = draw(st.sampled_from((0.05, 0.4, 1.0, 1.2)))
    position = size * np.array(draw(block)).reshape(k, joints)
    rates = [None, None]
    for degree in range(draw(st.integers(0, 2))):
        rates[degree] = draw(st.sampled_from((0.1, 1.0, 2.0))) * np.array(draw(block)).reshape(k, joints)
    return Trajectory(time, position, np.ones(joints, np.bool_), rates[0], rates[1])


REFERENCES = st.builds(
    lambda p, v: Reference(np.array(p), np.array(v), np.zeros(2)),
    st.lists(st.floats(-2.1, 2.1), min_size=2, max_size=2),
    st.lists(st.sampled_from((0.0, 0.0, 0.3, -1.0)), min_size=2, max_size=2),
)
NEVER = inf
