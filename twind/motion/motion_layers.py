"""Goals that wait, goals that run, and their order: the newest one decides its joints.

A layer's curve begins at the reference of the moment it starts, so there is no step (JTC "replacement").
Joints that a newer layer does not name keep the older curve; a layer without joints is dropped.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import inf

import numpy as np

from twind.motion.goal_conditions import GoalTolerances
from twind.motion.time_scaling import Stretch, TimeScaling, next_pace
from twind.robot.arrays import Bools, Floats
from twind.robot.finding import Finding, ReasonCode
from twind.robot.joint_limits import JointLimits
from twind.robot.splines import Spline, interpolate
from twind.robot.trajectory import Reference, Trajectory
from twind.safety.lead_in import JUMP, led_in

ROUNDING = 1e-9  # s: a tick this close to the end of a curve is at its end


@dataclass(frozen=True, slots=True, eq=False)
class ScheduledGoal:
    """Accepted trajectory with the options of its request."""

    id: str
    path: Trajectory
    start: int  # tick
    tolerances: GoalTolerances | None
    goal_time: float | None  # s after the end within which the goal tolerances must be met; None, 0: ever
    foreseen: Floats | None = None  # rad, (n,), start position when it was judged; None: at once

    @property
    def judged_at_end(self) -> bool:
        """True when its end is judged by measured positions."""
        return self.tolerances is not None and bool((self.tolerances.goal != inf).any())


@dataclass(frozen=True, slots=True, eq=False)
class MotionLayer:
    """A goal that has begun, and the joints that follow it."""

    goal: ScheduledGoal
    curve: Spline
    joints: Bools  # (n,)
    whole: bool  # all of them
    period: float  # s
    # shared by the rest of the layer when joints leave
    pace: TimeScaling = field(default_factory=TimeScaling)

    def elapsed(self, tick: int) -> float:
        """Return the time on the curve, s; its exact duration when within rounding of it.

        `tick` may lie ahead.
        """
        t = (tick - self.goal.start - self.pace.lag) * self.period
        duration = self.curve.duration
        return duration if abs(t - duration) <= ROUNDING else t

    def is_finished(self, tick: int) -> bool:
        """Check whether the end of the curve has been reached."""
        return self.elapsed(tick) >= self.curve.duration

    def reference_at(self, tick: int) -> Reference:
        """Return the reference on the curve; at rest on its last point after the end."""
        reference = self.curve.sample(self.elapsed(tick))
        assert reference is not None  # a layer is never sampled before its start
        return reference if self.pace.even else self.pace.scale_reference(reference, self.period)

    def keep_pace(self, tick: int, share: float, reasons: Sequence[ReasonCode], limits: JointLimits) -> None:
        """Advance its time by a share of a tick, as `reasons` demand; after its end by a whole one."""
        pace = self.pace
        if share == 1.0 and pace.even:
            return
        at = self.elapsed(tick)
        if at >= self.curve.duration:
            pace.step(1.0)
            return
        pace.blame(reasons)
        pace.step(next_pace(self.curve, self.joints, at, pace, share, limits, self.period))

    def miss(self, tick: int, count: int) -> None:
        """Count ticks that did not occur just before `tick`: it ends so much later."""
        if self.goal.start < tick and not self.is_finished(tick):
            self.pace.missed += count
            self.pace.blame((ReasonCode.LOOP_LATE,))

    @property
    def stretch(self) -> Stretch:
        """Its duration as accepted, and the time that it lost so far."""
        pace = self.pace
        added = round((pace.lag + pace.missed) * self.period, 6)  # a microsecond: rounding of summed shares
        return Stretch(self.curve.duration, added, tuple(pace.reasons))

    def outside(self, error: Floats, bound: Floats) -> Bools:
        """Return joints (n,) of the goal whose `error` is beyond `bound`; inf bounds nothing."""
        out: Bools = ~(error <= bound) & (bound != inf) & self.goal.path.commanded
        return out

    def fraction(self, tick: int) -> float:
        """Return the share of the curve that is done, 0..1."""
        duration = self.curve.duration
        return min(1.0, self.elapsed(tick) / duration) if duration > 0.0 else 1.0


def displaced(goal: ScheduledGoal, reference: Reference) -> Finding | None:
    """Return the reason why a waiting goal cannot begin here: it was judged from another place.

    None: it can.
    """
    if goal.foreseen is None:
        return None
    off = np.where(goal.path.commanded, np.abs(goal.foreseen - reference.position), 0.0)
    if (off <= JUMP).all():
        return None
    joint = int(np.argmax(off))
    message = "rad from where it was to begin: what moved before was slowed down"
    return Finding(ReasonCode.START_JUMP, joint, value=float(off[joint]), bound=JUMP, message=message)


def begun(goal: ScheduledGoal, reference: Reference, limits: JointLimits, period: float) -> MotionLayer:
    """Return the layer of a goal that starts now, from `reference`."""
    curve = interpolate(led_in(goal.path, reference, limits, period), reference)
    joints = goal.path.commanded
    return MotionLayer(goal, curve, joints, bool(joints.all()), period)


def without(layers: Sequence[MotionLayer], joints: Bools) -> list[MotionLayer]:
    """Return the layers after `joints` (n,) have left them; empty layers are dropped."""
    left = []
    for layer in layers:
        keeps = layer.joints & ~joints
        if keeps.any():
            left.append(replace(layer, joints=keeps, whole=bool(keeps.all())))
    return left


def overlay(base: Reference, layers: Sequence[MotionLayer], tick: int) -> Reference:
    """Return `base`, with the joints of each layer taken from it."""
    for layer in layers:
        base = choose(layer.joints, layer.reference_at(tick), base)
    return base


def choose(joints: Bools, chosen: Reference, others: Reference) -> Reference:
    """Return `chosen` for `joints` (n,), `others` for the rest."""
    return Reference(
        np.where(joints, chosen.position, others.position),
        np.where(joints, chosen.velocity, others.velocity),
        np.where(joints, chosen.acceleration, others.acceleration),
    )
