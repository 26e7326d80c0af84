"""Clearance, torque and balance of a path before it is sent, in slices. Front process.

Judges the curve that the executor would follow from its present reference: with lead-in for a start that
jumps, and with the ramp of a requested stop. A path that the loop slows down (`retime`) keeps its curve as
long as it begins at rest, so the verdict holds. Joints that the path does not command are assumed to stay;
their motion, and a start from a moving reference, is checked while it happens (LOOKAHEAD_COLLISION).
"""

from collections.abc import Generator, Sequence
from typing import Protocol

import numpy as np

from twind.exceptions import InvalidInput
from twind.robot.arrays import Floats
from twind.robot.finding import Finding, ReasonCode, Verdict
from twind.robot.joint_limits import JointLimits
from twind.robot.splines import Spline, interpolate, passed
from twind.robot.trajectory import Reference, Trajectory
from twind.safety.gate_types import GateThresholds
from twind.safety.lead_in import led_in
from twind.safety.retime import with_stop
from twind.twin.binding import Binding
from twind.twin.collision_model import CollisionModel
from twind.twin.curve_sweep import CloseGeoms, CurveSweep, SweepResult

TOLD = 8  # pairs of bodies that one verdict names
STEP = 0.02  # s between two samples of torque and balance
SAMPLES = 3000  # of one path at most


class DynamicsCheck(Protocol):
    """Check of torque and balance (TORQUE_INFEASIBLE, UNSTABLE_POSE): `twin/dynamics.py`."""

    def judging(
        self, time: Floats, position: Floats, velocity: Floats, acceleration: Floats
    ) -> Generator[None, None, Verdict]:
        """Judge samples of a path: time (k,), s, the others (k, n)."""


class TrajectoryPrecheck:
    """One robot's paths, judged one at a time. Keeps models of its own."""

    def __init__(self, binding: Binding, period: float, strength: DynamicsCheck | None = None) -> None:
        """`period`: s, of a tick. Raises InvalidInput where no two bodies could be judged."""
        self.bodies = CollisionModel(binding)
        self._limits = binding.limits
        self._period = period
        self._strength = strength
        if not (self.bodies.pairs or binding.robot.gate.collision.bodiless):
            file = binding.robot.path
            raise InvalidInput(f"{file}: no two bodies of the model can collide: contype, conaffinity, allow")

    def judging(
        self, path: Trajectory, reference: Reference, *, append_stop: bool = False
    ) -> Generator[None, None, Verdict]:
        """Judge `path` from `reference`, in slices of 2 ms at most. An unknown position refuses."""
        if not np.isfinite(reference.position).all():
            joint = int(np.argmin(np.isfinite(reference.position)))
            reason = "the position of this joint is unknown, so its path cannot be checked"
            return Verdict((Finding(ReasonCode.SELF_COLLISION, joint=joint, message=reason),))
        whole = with_stop(path, self._limits, GateThresholds())[0] if append_stop else path
        curve = along_the_way(whole, reference, self._limits, self._period)
        late = curve.duration - float(whole.time[-1])
        verdict = Verdict()
        if self.bodies.pairs:
            found: SweepResult = yield from CurveSweep(self.bodies).running(curve)
            verdict = self._clearance(found, whole, late)
            if found.unfinished:
                return verdict
        if self._strength is None:
            return verdict
        yield
        more = yield from self._strength.judging(*samples(curve))
        return Verdict(
            (*verdict.refusals, *_on_the_path(more.refusals, whole, late)),
            (*verdict.warnings, *_on_the_path(more.warnings, whole, late)),
        )

    def _clearance(self, found: SweepResult, path: Trajectory, late: float) -> Verdict:
        refused = [self._finding(close, path, late, near=False) for close in found.refused[:TOLD]]
        warned = [self._finding(close, path, late, near=True) for close in found.warned[:TOLD]]
        if found.unfinished and not refused:
            reason = f"not proved clear after {found.work} poses: a shorter way, or one further from itself"
            refused = [Finding(ReasonCode.SELF_COLLISION, message=reason)]
        return Verdict(tuple(refused), tuple(warned))

    def _finding(self, close: CloseGeoms, path: Trajectory, late: float, *, near: bool) -> Finding:
        """Return the finding of a pair: start and worst distance. `near`: within the band that only warns."""
        pair = self.bodies.pairs[close.pair]
        time = max(close.time - late, 0.0)
        least = max(close.at - late, 0.0)
        bound = pair.block + self.bodies.band if near else pair.block
        what = "near each other" if near else "too close"
        reason = f"{pair.name} {what} (m between them; the least at {least:.3g} s)"
        return Finding(pair.code, None, passed(path, time), time, close.clearance, bound, reason)


def along_the_way(path: Trajectory, reference: Reference, limits: JointLimits, period: float) -> Spline:
    """Return the curve that the executor would follow from `reference`, lead-in included."""
    return interpolate(led_in(path, reference, limits, period), reference)


def samples(curve: Spline) -> tuple[Floats, Floats, Floats, Floats]:
    """Return time (k,), position, velocity and acceleration (k, n) along a curve."""
    count = int(np.clip(np.ceil(curve.duration / STEP), 1, SAMPLES)) + 1
    time = np.linspace(0.0, curve.duration, count)
    over = time >= curve.time[-1]
    still = np.zeros((count, len(curve.end)))
    if not len(curve.coefficients):
        return time, still + curve.end, still, still
    segment = np.clip(np.searchsorted(curve.time, time, side="right") - 1, 0, len(curve.coefficients) - 1)
    rows = curve.coefficients[segment]
    u = (time - curve.time[segment])[:, None]
    power = np.arange(rows.shape[1])
    found = []
    for _ in range(3):  # the value and both derivatives
        found.append(np.einsum("kd,kdn->kn", u ** np.arange(rows.shape[1]), rows))
        rows = rows[:, 1:] * power[1 : rows.shape[1]][:, None]
    position, velocity, acceleration = (np.where(over[:, None], 0.0, row) for row in found)
    position[over] = curve.end
    return time, position, velocity, acceleration


def _on_the_path(findings: Sequence[Finding], path: Trajectory, late: float) -> list[Finding]:
    """Return findings on the curve in times and points of the submitted path."""
    placed = []
    for each in findings:
        time = None if each.time is None else max(each.time - late, 0.0)
        point = each.point if time is None else passed(path, time)
        placed.append(Finding(each.code, each.joint, point, time, each.value, each.bound, each.message))
    return placed
