"""The gate of streamed setpoints: one position per joint, CMD_EXPIRED to POS_LIMIT and VEL_LIMIT. Pure.

A stream needs no path: the executor follows it within velocity, acceleration and position limits.
"""

from dataclasses import dataclass

import numpy as np

from twind.robot.arrays import Floats, Ints
from twind.robot.finding import Finding, ReasonCode, Verdict
from twind.robot.joint_limits import JointLimits

LONGEST = 0.1  # s a setpoint may stay valid (STREAM_STALE): slower commands are trajectories


@dataclass(frozen=True, slots=True)
class SetpointResult:
    """Setpoint that the executor may follow, and the verdict. Arrays are (m,), in the caller's order."""

    verdict: Verdict
    joints: Ints
    position: Floats  # rad
    velocity: Floats | None  # rad/s


def judge(
    joints: Ints,
    position: Floats,
    velocity: Floats | None,
    limits: JointLimits,
    *,
    valid_for: float,
    allow_clamp: bool,
) -> SetpointResult:
    """Refuse malformed setpoints and those outside the limits; with `allow_clamp` clip and report them."""
    refusals = _form(joints, position, velocity, len(limits.lower), valid_for)
    if refusals:
        return SetpointResult(Verdict(tuple(refusals)), joints, position, velocity)
    low = limits.lower[joints]
    high = limits.upper[joints]
    fastest = limits.velocity[joints]
    inside = np.clip(position, low, high)
    slow = velocity
    found = [
        Finding(
            ReasonCode.POS_LIMIT,
            int(joints[at]),
            value=float(position[at]),
            bound=float(inside[at]),
            message="setpoint outside the limits",
        )
        for at in np.flatnonzero(inside != position)
    ]
    if velocity is not None:
        slow = np.clip(velocity, -fastest, fastest)
        found += [
            Finding(
                ReasonCode.VEL_LIMIT,
                int(joints[at]),
                value=float(velocity[at]),
                bound=float(slow[at]),
                message="setpoint velocity above the limit",
            )
            for at in np.flatnonzero(slow != velocity)
        ]
    if found and not allow_clamp:
        return SetpointResult(Verdict(tuple(found)), joints, position, velocity)
    return SetpointResult(Verdict(changes=tuple(found)), joints, inside, slow)


def _form(
    joints: Ints, position: Floats, velocity: Floats | None, count: int, valid_for: float
) -> list[Finding]:
    findings = []
    if not len(joints):
        findings.append(Finding(ReasonCode.NO_JOINTS, message="a setpoint of no joint"))
    if len(np.unique(joints)) != len(joints):
        findings.append(Finding(ReasonCode.DUP_JOINT, message="a joint is named twice"))
    if not ((joints >= 0) & (joints < count)).all():
        findings.append(Finding(ReasonCode.UNKNOWN_JOINT, bound=float(count - 1), message="no such joint"))
    rows = [position] if velocity is None else [position, velocity]
    if any(row.shape != joints.shape for row in rows):
        findings.append(
            Finding(ReasonCode.BAD_SHAPE, bound=float(len(joints)), message="one number per joint is needed")
        )
    elif not all(np.isfinite(row).all() for row in rows):
        findings.append(Finding(ReasonCode.NONFINITE, message="a setpoint must be finite"))
    if not valid_for > 0.0:
        findings.append(
            Finding(ReasonCode.CMD_EXPIRED, value=valid_for, bound=0.0, message="already expired")
        )
    elif not valid_for <= LONGEST:
        reason = "valid too long (s): a dead client must not keep a robot moving"
        findings.append(Finding(ReasonCode.VALID_TOO_LONG, value=valid_for, bound=LONGEST, message=reason))
    return findings
