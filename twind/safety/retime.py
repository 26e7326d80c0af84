"""Changes that the gate makes and reports: slow a path (`retime`), bring it to rest (END_NOT_AT_REST)."""

from collections.abc import Iterable
from dataclasses import replace
from math import inf, isnan, sqrt

import numpy as np

from twind.robot.finding import Finding, ReasonCode
from twind.robot.joint_limits import JointLimits
from twind.robot.trajectory import Trajectory
from twind.safety.gate_types import GateThresholds

HEALED = (
    ReasonCode.VEL_LIMIT,
    ReasonCode.ACC_LIMIT,
    ReasonCode.BRAKE_DISTANCE,
)  # what a slower path can heal, in rule order
ROUNDS = 8  # guesses of the factor; from rest the first one holds
NUDGE = 1e-9  # relative: keeps a mathematically exact factor on the right side of rounding


def needed(findings: Iterable[Finding], first: bool = True) -> float:
    """Return the stretch that heals every finding by itself: speeds fall with it, accelerations squared.

    After the `first` guess, the rest comes from a reference that does not slow down with the path. There
    accelerations fall with the stretch itself. NaN or infinite where nothing heals.
    """
    factor = 1.0
    for finding in findings:
        if finding.value is not None and finding.bound is not None and finding.code in HEALED:
            ratio = finding.value / finding.bound if finding.bound > 0.0 else inf
            ratio = sqrt(ratio) if first and finding.code is ReasonCode.ACC_LIMIT else ratio
            factor = ratio if isnan(ratio) else max(factor, ratio)
    return factor * (1.0 + NUDGE)


def slowest(findings: Iterable[Finding]) -> Finding:
    """Return the finding that asks for the largest stretch."""
    return max(findings, key=lambda each: needed([each]))


def with_stop(
    path: Trajectory, limits: JointLimits, thresholds: GateThresholds
) -> tuple[Trajectory, list[Finding]]:
    """Return `path` with a ramp to rest after its last point, and the finding on it; unchanged if at rest.

    All joints stop together, each with constant deceleration, the hardest pressed one at its limit. Where
    accelerations are given it is half of the limit, because a quintic peaks higher. The ramp is judged like
    the rest.
    """
    if path.velocity is None:
        return path, []
    v = np.where(path.commanded, path.velocity[-1], 0.0)
    if np.all(np.abs(v) <= thresholds.end_velocity):
        return path, []
    share = 1.0 if path.acceleration is None else 0.5
    with np.errstate(all="ignore"):
        pressed = np.where(path.commanded, np.abs(v) / (share * limits.acceleration), 0.0)
        T = max(float(np.max(pressed)) * (1.0 + NUDGE), thresholds.min_dt)
    reason = "a ramp to rest of this many seconds follows the last point"
    place = len(path.time) - 1
    t = float(path.time[-1])
    return ramped(path, T), [Finding(ReasonCode.STOP_APPENDED, point=place, time=t, value=T, message=reason)]


def ramped(path: Trajectory, duration: float) -> Trajectory:
    """Return `path`, which has velocities, brought to rest with constant decelerations in `duration` s."""
    assert path.velocity is not None  # else there is nothing to bring to rest
    with np.errstate(all="ignore"):
        end = path.position[-1] + 0.5 * path.velocity[-1] * duration
    still = np.zeros((1, len(end)))
    return replace(
        path,
        time=np.append(path.time, path.time[-1] + duration),
        position=np.vstack([path.position, end]),
        velocity=np.vstack([path.velocity, still]),
        acceleration=None if path.acceleration is None else np.vstack([path.acceleration, still]),
    )


def changed(path: Trajectory, changes: Iterable[Finding]) -> Trajectory:
    """Return the path after the `changes` of a verdict: the path that was judged."""
    for change in changes:
        assert change.value is not None  # a change always states its size
        if change.code is ReasonCode.STOP_APPENDED:
            path = ramped(path, change.value)
        elif change.code is ReasonCode.RETIMED:
            path = path.stretched(change.value)
    return path
