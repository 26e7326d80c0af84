"""The gate at submit time: judges whether a trajectory may move the robot now (docs/reason-codes.md).

Pure: no clock, no device, no globals. A refusal is a value; nothing here raises on any numbers, and every
value that is NaN, missing or unknown refuses. All failing codes are returned, in the order of the rules. Runs
in the loop, a slice per tick (`checking`).
"""

from collections.abc import Generator, Iterable
from dataclasses import replace
from math import ceil, inf

import numpy as np

from twind.robot import splines
from twind.robot.finding import Finding, ReasonCode, Verdict
from twind.robot.joint_limits import JointLimits
from twind.robot.trajectory import Reference, Trajectory
from twind.safety import retime
from twind.safety.admission import admit
from twind.safety.curve_rules import JudgedCurve, WorstPoint, judge, relaxed, resting, some, start
from twind.safety.gate_types import GateResult, GateSnapshot, GateThresholds, TrajectoryRequest
from twind.safety.lead_in import led_in
from twind.safety.trajectory_validation import wellformed

__all__ = [
    "GateResult",
    "GateSnapshot",
    "GateThresholds",
    "TrajectoryRequest",
    "check",
    "checking",
]

MOST = 64  # findings of one code
UNKNOWN_START = "its position or speed is unknown: see `twindctl status --joints`"


def _check_request(demand: TrajectoryRequest, thresholds: GateThresholds) -> list[Finding]:
    """Check BAD_SCHEMA, CMD_EXPIRED and TOO_DISTANT of the request itself."""
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
    """Run `checking` to its end at once."""
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
    """Do the work of `checking`; before each slice yield its number of points, at most `step`."""
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
    spots = yield from _judging(path, before, limits, thresholds, snapshot.period, step)
    if demand.policy == "retime" and _slower_heals(spots):
        slower = yield from _stretching(path, spots, before, limits, thresholds, snapshot.period, step)
        if slower is not None:
            cause = retime.slowest(spot.finding for spot in spots.values())
            times = f"{slower[0].time[-1]:.2f} s instead of {path.time[-1]:.2f} s"
            reason = f"the whole path slowed down by this factor, to {times}, for {cause.code}"
            path, spots, factor = slower
            changes.append(Finding(ReasonCode.RETIMED, cause.joint, value=factor, bound=1.0, message=reason))
    refusals += _worst(spots, ReasonCode.POS_LIMIT)
    refusals += _start_jump(path, snapshot.reference, limits, thresholds)
    too_fast = [finding for code in retime.HEALED for finding in _worst(spots, code)]
    refusals += _with_needed_time(too_fast, path, snapshot.reference) if _slower_heals(spots) else too_fast
    refusals += [*_end(path, thresholds), *busy]
    warnings = (*admission.warnings, *_worst(spots, ReasonCode.JERK_LIMIT))
    with np.errstate(all="ignore"):
        curve = splines.interpolate(path, before)
    return GateResult(Verdict(tuple(refusals), warnings, tuple(changes)), path, curve)


Spots = dict[tuple[ReasonCode, int], WorstPoint]  # the worst place of each joint by each rule


def _judging(
    path: Trajectory,
    before: Reference,
    limits: JointLimits,
    thresholds: GateThresholds,
    period: float,
    step: int,
) -> Generator[int, None, Spots]:
    """Apply the rules on the curve, a slice at a time. `before` is finite in the commanded joints."""
    subject = _subject(path, before, limits)
    found = start(subject, thresholds) + _lead(path, before, limits, thresholds, period)
    i = 0
    segments = len(subject.knots.time) - 1
    outside = relaxed(subject)
    # no segment checks the last point against the limits themselves
    if segments == (0 if outside is None else 1):
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


def _lead(
    path: Trajectory, before: Reference, limits: JointLimits, thresholds: GateThresholds, period: float
) -> list[WorstPoint]:
    """Apply the rules on the way to a first point at t = 0 that jumps: a fast one is met with a run-up.

    A jump or a speed that is refused in any case has no such way.
    """
    with np.errstate(all="ignore"):
        possible = np.abs(path.position[0] - before.position) <= thresholds.start_jump
        if path.velocity is not None:
            possible &= np.abs(path.velocity[0]) <= limits.velocity
    head = replace(  # two points tell that way, and the corner at its end; of 2000 a copy lasts 1 ms
        path,
        time=path.time[:2],
        position=path.position[:2],
        velocity=None if path.velocity is None else path.velocity[:2],
        acceleration=None if path.acceleration is None else path.acceleration[:2],
    )
    led = led_in(head, before, limits, period) if possible[path.commanded].all() else head
    if led is head:
        return []
    way = _subject(led, before, limits)
    spots = judge(way, 0, 1, relaxed(way) or way.limits, thresholds)
    return [replace(spot, finding=replace(spot.finding, time=0.0)) for spot in spots]


def _stretching(
    path: Trajectory,
    spots: Spots,
    before: Reference,
    limits: JointLimits,
    thresholds: GateThresholds,
    period: float,
    step: int,
) -> Generator[int, None, tuple[Trajectory, Spots, float] | None]:
    """Return the smallest uniform stretch after which nothing is too fast; None where there is none.

    From rest the first guess is the result. A moving reference does not slow down with the path, so the guess
    is corrected by judging again.
    """
    factor = 1.0
    for attempt in range(retime.ROUNDS):
        factor *= retime.needed((spot.finding for spot in spots.values()), first=attempt == 0)
        if not float(path.time[-1]) * factor <= thresholds.max_duration:
            return None
        slower = path.stretched(factor)
        spots = yield from _judging(slower, before, limits, thresholds, period, step)
        if not any(code is not ReasonCode.JERK_LIMIT for code, _ in spots):
            return slower, spots, factor
        if not _slower_heals(spots):
            return None
    return None


def _slower_heals(spots: Spots) -> bool:
    """Check that something is too fast, and no position is wrong: time never corrects a position."""
    codes = {code for code, _ in spots}
    return bool(codes & set(retime.HEALED)) and ReasonCode.POS_LIMIT not in codes


def _subject(path: Trajectory, before: Reference, limits: JointLimits) -> JudgedCurve:
    """Return the curve of the commanded joints alone."""
    joints = np.flatnonzero(path.commanded)
    knots = splines.knots(path, before)
    velocity = before.velocity
    if len(joints) < len(path.commanded):
        rows = (knots.velocity, knots.acceleration)
        thin = [None if given is None else given[:, joints] for given in rows]
        knots = splines.Knots(knots.time, knots.position[:, joints], *thin)
        limits = some(limits, joints)
        velocity = velocity[joints]
    return JudgedCurve(knots, joints, limits, velocity, len(knots.time) - len(path.time))


def _fill_reference(path: Trajectory, reference: Reference) -> Reference:
    """Return the reference with unknown values filled in, so that the rest of the path can be judged.

    START_JUMP refuses an unknown position in any case.
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
        located = bool(rates[joint]) and bool(np.isfinite(reference.position[joint]))
        at = float(path.time[0])
        finding = Finding(ReasonCode.START_JUMP, int(joint), 0, at, message=UNKNOWN_START)
        if located:
            value = float(jump[joint])
            reason = "from the reference to the first point"
            finding = Finding(ReasonCode.START_JUMP, int(joint), 0, at, value, float(bound[joint]), reason)
        findings.append(finding)
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


def _with_needed_time(findings: list[Finding], path: Trajectory, before: Reference) -> list[Finding]:
    """Return the findings with the duration (s) at which the path would pass, where it begins at rest."""
    moving = before.velocity[path.commanded].any() or before.acceleration[path.commanded].any()
    seconds = float(path.time[-1]) * retime.needed(findings)
    if moving or not seconds < inf:  # NaN too
        return findings
    text = f"the whole path needs {ceil(seconds * 100.0) / 100.0:.2f} s"
    return [replace(each, message=f"{each.message}; {text}" if each.message else text) for each in findings]


def _worst(spots: Spots, code: ReasonCode) -> Iterable[Finding]:
    """Return the findings of one code, worst joint first."""
    chosen = sorted((spot for (kind, _), spot in spots.items() if kind is code), key=lambda spot: -spot.score)
    return [spot.finding for spot in chosen[:MOST]]
