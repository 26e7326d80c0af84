"""The gate at submit time: may this trajectory move this robot, now (codes: docs/reason-codes.md)?

Pure: no clock, no device, no globals. A refusal is a value; nothing here raises on any numbers, and whatever
is NaN, missing or unknown refuses. All failing codes are returned, in the order of the rules. Runs in the
loop, a slice per tick (`checking`).
"""

from collections.abc import Generator, Iterable
from dataclasses import dataclass

import numpy as np

from twind.robot import splines
from twind.robot.arrays import Bools, Floats
from twind.robot.finding import Finding, ReasonCode, Verdict
from twind.robot.joint_limits import JointLimits
from twind.robot.modes import Mode, Motion, RobotState
from twind.robot.splines import Spline
from twind.robot.trajectory import Reference, Trajectory
from twind.safety import retime
from twind.safety.curve_rules import (
    CurveSubject,
    GateThresholds,
    WorstPoint,
    judge,
    relaxed,
    resting,
    some,
    start,
)
from twind.safety.headroom import JointCondition, headroom
from twind.safety.trajectory_validation import wellformed

__all__ = [
    "GateResult",
    "GateSnapshot",
    "GateThresholds",
    "TrajectoryRequest",
    "admit",
    "arming",
    "check",
    "checking",
]

MOST = 64  # findings of one code


@dataclass(frozen=True, slots=True)
class GateSnapshot:
    """What the gate must know, at one instant. Arrays are (n,), in joint order."""

    now: float  # s
    mode: Mode
    state: RobotState
    motion: Motion
    latched: tuple[ReasonCode, ...]  # what has latched a fault or an e-stop
    lease_held: bool  # by the connection that asks
    mismatches: tuple[Finding, ...]  # calibration against read-back (CALIB_MISMATCH)
    calibrated: Bools
    age: Floats  # s since each joint of the target was heard, inf never
    latency: float  # s, state age + bus round trip, now; NaN unknown
    latency_p95: float  # s, of the last 0.5 s; NaN unknown
    reference: Reference  # last commanded while holding or moving, measured otherwise
    busy: bool = False  # one trajectory runs and one waits
    bars: tuple[Finding, ...] = ()  # findings of servos and buses that prevent arming now
    unreachable: Finding | None = None  # why no new client can connect; None: clients can
    condition: JointCondition | None = None  # temperature and supply; None: not known, which refuses


@dataclass(frozen=True, slots=True)
class TrajectoryRequest:
    """How the trajectory is asked for."""

    policy: str = "reject"  # or "retime": one uniform stretch in time, reported
    append_stop: bool = False
    start_in: float = 0.0  # s from now


@dataclass(frozen=True, slots=True)
class GateResult:
    """The verdict, and what would run: the path as asked, or as the verdict's changes say.

    Where the path's form allows no curve, `spline` stays at the reference.
    """

    verdict: Verdict
    path: Trajectory
    spline: Spline


# ------------------------------------------------------------------------------------------ admission


def admit(
    snapshot: GateSnapshot, commanded: Bools, thresholds: GateThresholds, *, setpoint: bool = False
) -> Verdict:
    """Check whether these joints may move now (LEASE_MISSING to THERMAL_HEADROOM). Hardware counts in live.

    A stream begins with its first `setpoint`: what gets hot later is the guard's to slow down and settle.
    """
    refusals = [*_lease(snapshot), *_latches(snapshot), *_reach(snapshot)]
    warnings: list[Finding] = []
    if snapshot.mode is Mode.LIVE:
        if snapshot.state is not RobotState.ARMED:
            reason = f"state is {snapshot.state}; arm first"
            refusals.append(Finding(ReasonCode.NOT_ARMED, message=reason))
        refusals += _calibration(snapshot, commanded) + _hearing(snapshot, commanded, thresholds)
        late, warnings = _latency(snapshot, thresholds)
        refusals += late
        if not (setpoint and snapshot.motion is Motion.STREAMING):
            refusals += _room(snapshot, commanded, thresholds)
    return Verdict(tuple(refusals), tuple(warnings))


def arming(snapshot: GateSnapshot, thresholds: GateThresholds, joints: Bools | None = None) -> Verdict:
    """Check whether torque comes on (LEASE_MISSING to THERMAL_HEADROOM). In live only, from `connected`."""
    chosen = np.ones_like(snapshot.calibrated) if joints is None else joints
    refusals = [*_lease(snapshot), *_latches(snapshot), *_reach(snapshot)]
    if snapshot.mode is not Mode.LIVE:
        reason = f"mode {snapshot.mode} has no torque to switch on; arm in mode live"
        return Verdict((*refusals, Finding(ReasonCode.MODE_DENIES, message=reason)))
    if snapshot.state is not RobotState.CONNECTED:
        reason = f"state is {snapshot.state}; arming starts from connected"
        refusals.append(Finding(ReasonCode.ARM_FAILED, message=reason))
    if not chosen.any():
        refusals.append(Finding(ReasonCode.NO_JOINTS, message="no joint to arm"))
    refusals += _calibration(snapshot, chosen) + _hearing(snapshot, chosen, thresholds)
    late, warnings = _latency(snapshot, thresholds)
    room = _room(snapshot, chosen, thresholds)
    return Verdict((*refusals, *late, *room, *snapshot.bars), tuple(warnings))


def _lease(snapshot: GateSnapshot) -> list[Finding]:
    """Check LEASE_MISSING."""
    reason = "this connection does not hold the lease; take it first"
    return [] if snapshot.lease_held else [Finding(ReasonCode.LEASE_MISSING, message=reason)]


def _latches(snapshot: GateSnapshot) -> list[Finding]:
    """FAULT_LATCHED. The states themselves count as latches, whatever the list says."""
    stops = {ReasonCode.ESTOP, ReasonCode.ESTOP_LATCHED}
    faults = [code for code in snapshot.latched if code not in stops]
    findings = []
    if snapshot.state is RobotState.ESTOP or stops & set(snapshot.latched):
        findings.append(Finding(ReasonCode.ESTOP_LATCHED, message="e-stop is latched; reset it first"))
    if faults or snapshot.state in (RobotState.FAULT, RobotState.INHIBITED):
        named = ", ".join(dict.fromkeys(faults)) or f"state is {snapshot.state}"
        findings.append(Finding(ReasonCode.FAULT_LATCHED, message=f"latched: {named}; reset it first"))
    return findings


def _reach(snapshot: GateSnapshot) -> list[Finding]:
    """What moves must be within reach of an e-stop: no motion begins while no client can connect."""
    return [] if snapshot.unreachable is None else [snapshot.unreachable]


def _calibration(snapshot: GateSnapshot, chosen: Bools) -> list[Finding]:
    """Check CALIB_MISMATCH."""
    reason = "no measured zero; calibrate this joint"
    missing = [
        Finding(ReasonCode.CALIB_MISSING, joint=int(joint), message=reason)
        for joint in np.flatnonzero(chosen & ~snapshot.calibrated)
    ]
    return missing + list(snapshot.mismatches)


def _hearing(snapshot: GateSnapshot, chosen: Bools, thresholds: GateThresholds) -> list[Finding]:
    """HW_DISCONNECTED. An age that is negative or NaN is too old."""
    fresh = (snapshot.age >= 0.0) & (snapshot.age <= thresholds.stale)
    reason = "not heard lately (s); check its cable and power"
    return [
        Finding(
            ReasonCode.HW_DISCONNECTED,
            int(joint),
            None,
            None,
            float(snapshot.age[joint]),
            thresholds.stale,
            reason,
        )
        for joint in np.flatnonzero(chosen & ~fresh)
    ]


def _latency(snapshot: GateSnapshot, thresholds: GateThresholds) -> tuple[list[Finding], list[Finding]]:
    """LATENCY_BLOCK: refusals and warnings. Unknown or negative refuses."""
    block = thresholds.latency_block
    warn = thresholds.latency_warn
    refusals = []
    warnings = []
    for value, what in ((snapshot.latency, "now"), (snapshot.latency_p95, "95 % of the last 0.5 s")):
        reason = f"state age + bus round trip, {what} (s)"
        if not 0.0 <= value <= block:
            refusals.append(Finding(ReasonCode.LATENCY_BLOCK, value=value, bound=block, message=reason))
        elif not value <= warn:
            warnings.append(Finding(ReasonCode.LATENCY_WARN, value=value, bound=warn, message=reason))
    return refusals, warnings


def _room(snapshot: GateSnapshot, chosen: Bools, thresholds: GateThresholds) -> list[Finding]:
    """Check THERMAL_HEADROOM."""
    if snapshot.condition is None:
        reason = "temperature and supply are not known"
        return [
            Finding(code, message=reason) for code in (ReasonCode.THERMAL_HEADROOM, ReasonCode.VOLTAGE_LOW)
        ]
    return headroom(snapshot.condition, chosen, thresholds.health)


def _check_request(demand: TrajectoryRequest, thresholds: GateThresholds) -> list[Finding]:
    """BAD_SCHEMA, CMD_EXPIRED: the demand itself."""
    findings = []
    if demand.policy not in ("reject", "retime"):
        reason = f"policy {demand.policy!r} is neither reject nor retime"
        findings.append(Finding(ReasonCode.BAD_SCHEMA, message=reason))
    if not demand.start_in >= 0.0:
        findings.append(
            Finding(ReasonCode.CMD_EXPIRED, value=demand.start_in, bound=0.0, message="starts in the past")
        )
    elif not demand.start_in <= thresholds.max_duration:
        most = thresholds.max_duration
        findings.append(
            Finding(ReasonCode.TOO_DISTANT, value=demand.start_in, bound=most, message="starts too late (s)")
        )
    return findings


# ------------------------------------------------------------------------------------------ the whole


def check(
    path: Trajectory,
    snapshot: GateSnapshot,
    limits: JointLimits,
    demand: TrajectoryRequest,
    thresholds: GateThresholds,
    points_per_step: int = 500,
) -> GateResult:
    """`checking`, run to its end at once."""
    steps = checking(path, snapshot, limits, demand, thresholds, points_per_step)
    while True:
        try:
            next(steps)
        except StopIteration as stop:
            judged: GateResult = stop.value
            return judged


def checking(
    path: Trajectory,
    snapshot: GateSnapshot,
    limits: JointLimits,
    demand: TrajectoryRequest,
    thresholds: GateThresholds,
    points_per_step: int = 500,
) -> Generator[None, None, GateResult]:
    """Judge `path` by every rule of submit time, at most `points_per_step` points between two yields.

    A path of no more points is judged without a yield. With a start in the future `snapshot.reference` must
    be the one expected then.
    """
    slices = _slices(path, snapshot, limits, demand, thresholds, points_per_step)
    spent = 0
    while True:
        try:
            points = next(slices)
        except StopIteration as stop:
            judged: GateResult = stop.value
            return judged
        if spent and spent + points > points_per_step:
            yield
            spent = 0
        spent += points


def _slices(
    path: Trajectory,
    snapshot: GateSnapshot,
    limits: JointLimits,
    demand: TrajectoryRequest,
    thresholds: GateThresholds,
    step: int,
) -> Generator[int, None, GateResult]:
    """The work of `checking`: yields before each slice how many points it has, at most `step`."""
    count = len(limits.lower)
    shape = wellformed(path, count, thresholds.max_points, thresholds.max_duration, thresholds.min_dt)
    chosen = np.ones(count, np.bool_) if shape else path.commanded
    admission = admit(snapshot, chosen, thresholds)
    refusals = [*admission.refusals, *_check_request(demand, thresholds), *shape]
    busy = [
        Finding(ReasonCode.BUSY, message="one trajectory runs and one waits; cancel or wait")
    ] * snapshot.busy
    if shape:
        verdict = Verdict((*refusals, *busy), admission.warnings)
        return GateResult(verdict, path, splines.hold(snapshot.reference.position))
    before = _fill_reference(path, snapshot.reference)
    changes: list[Finding] = []
    if demand.append_stop:
        path, changes = retime.with_stop(path, limits, thresholds)
    spots = yield from _judging(path, before, limits, thresholds, step)
    if demand.policy == "retime" and _slower_heals(spots):
        slower = yield from _stretching(path, spots, before, limits, thresholds, step)
        if slower is not None:
            path, spots, factor = slower
            reason = "the whole path slowed down by this factor"
            changes.append(Finding(ReasonCode.RETIMED, value=factor, bound=1.0, message=reason))
    refusals += _worst(spots, ReasonCode.POS_LIMIT)
    refusals += _start_jump(path, snapshot.reference, limits, thresholds)
    refusals += [finding for code in retime.HEALED for finding in _worst(spots, code)]
    refusals += [*_end(path, thresholds), *busy]
    warnings = (*admission.warnings, *_worst(spots, ReasonCode.JERK_LIMIT))
    with np.errstate(all="ignore"):
        curve = splines.interpolate(path, before)
    return GateResult(Verdict(tuple(refusals), warnings, tuple(changes)), path, curve)


Spots = dict[tuple[ReasonCode, int], WorstPoint]  # the worst place of each joint by each rule


def _judging(
    path: Trajectory, before: Reference, limits: JointLimits, thresholds: GateThresholds, step: int
) -> Generator[int, None, Spots]:
    """The rules on the curve, a slice at a time. `before` is finite in the commanded joints."""
    subject = _subject(path, before, limits)
    found = start(subject, thresholds)
    i = 0
    segments = len(subject.knots.time) - 1
    outside = relaxed(subject)
    if segments == (0 if outside is None else 1):  # no segment holds the last point to the limits themselves
        found += judge(resting(subject), 0, 1, subject.limits, thresholds)
    while i < segments:
        j = min(i + step, segments) if outside is None else i + 1
        yield j - i
        found += judge(subject, i, j, outside or subject.limits, thresholds)
        i = j
        outside = None
    worst: Spots = {}
    for spot in found:
        key = (spot.finding.code, spot.finding.joint or 0)
        if key not in worst or spot.score > worst[key].score:
            worst[key] = spot
    return worst


def _stretching(
    path: Trajectory,
    spots: Spots,
    before: Reference,
    limits: JointLimits,
    thresholds: GateThresholds,
    step: int,
) -> Generator[int, None, tuple[Trajectory, Spots, float] | None]:
    """The smallest uniform stretch after which nothing is too fast; None where there is none.

    From rest the first guess is the answer. A moving reference does not slow down with the path, so the guess
    is corrected by judging again.
    """
    factor = 1.0
    for attempt in range(retime.ROUNDS):
        factor *= retime.needed((spot.finding for spot in spots.values()), first=attempt == 0)
        if not float(path.time[-1]) * factor <= thresholds.max_duration:
            return None
        slower = path.stretched(factor)
        spots = yield from _judging(slower, before, limits, thresholds, step)
        if not any(code is not ReasonCode.JERK_LIMIT for code, _ in spots):
            return slower, spots, factor
        if not _slower_heals(spots):
            return None
    return None


def _slower_heals(spots: Spots) -> bool:
    """Something is too fast, and nothing is out of place: a place is never healed by time."""
    codes = {code for code, _ in spots}
    return bool(codes & set(retime.HEALED)) and ReasonCode.POS_LIMIT not in codes


def _subject(path: Trajectory, before: Reference, limits: JointLimits) -> CurveSubject:
    """The commanded joints alone."""
    joints = np.flatnonzero(path.commanded)
    knots = splines.knots(path, before)
    velocity = before.velocity
    if len(joints) < len(path.commanded):
        rows = (knots.velocity, knots.acceleration)
        thin = [None if given is None else given[:, joints] for given in rows]
        knots = splines.Knots(knots.time, knots.position[:, joints], *thin)
        limits = some(limits, joints)
        velocity = velocity[joints]
    return CurveSubject(knots, joints, limits, velocity, len(knots.time) - len(path.time))


def _fill_reference(path: Trajectory, reference: Reference) -> Reference:
    """The reference with what is unknown filled in, so that the rest of the path can be judged.

    An unknown place is refused by START_JUMP in any case.
    """
    position = np.where(np.isfinite(reference.position), reference.position, path.position[0])
    rates = (np.where(np.isfinite(rate), rate, 0.0) for rate in (reference.velocity, reference.acceleration))
    return Reference(position, *rates)


def _start_jump(
    path: Trajectory, reference: Reference, limits: JointLimits, thresholds: GateThresholds
) -> list[Finding]:
    """Check START_JUMP."""
    with np.errstate(all="ignore"):
        jump = np.abs(path.position[0] - reference.position)
        bound = thresholds.start_jump + limits.velocity * path.time[0]
    rates = np.isfinite(reference.velocity) & np.isfinite(reference.acceleration)
    findings = []
    for joint in np.flatnonzero(path.commanded & ~(rates & (jump <= bound))):
        known = bool(rates[joint]) and bool(np.isfinite(reference.position[joint]))
        reason = (
            "from the reference to the first point" if known else "the reference of this joint is unknown"
        )
        value = float(jump[joint])
        most = float(bound[joint])
        findings.append(
            Finding(ReasonCode.START_JUMP, int(joint), 0, float(path.time[0]), value, most, reason)
        )
    return findings


def _end(path: Trajectory, thresholds: GateThresholds) -> list[Finding]:
    """Check END_NOT_AT_REST. Positions alone end at rest; ACC_LIMIT judges the corner of the last line."""
    if path.velocity is None:
        return []
    last = np.abs(path.velocity[-1])
    bound = thresholds.end_velocity
    reason = "still moving at the last point; end at rest or ask for append_stop"
    point = len(path.time) - 1
    t = float(path.time[-1])
    return [
        Finding(ReasonCode.END_NOT_AT_REST, int(joint), point, t, float(last[joint]), bound, reason)
        for joint in np.flatnonzero(path.commanded & ~(last <= bound))
    ]


def _worst(spots: Spots, code: ReasonCode) -> Iterable[Finding]:
    """The findings of one code, worst joint first."""
    chosen = sorted((spot for (kind, _), spot in spots.items() if kind is code), key=lambda spot: -spot.score)
    return [spot.finding for spot in chosen[:MOST]]
