"""Goals that wait, goals that run, and how they lie over one another: the newest decides its joints.

A layer's curve begins at the reference of the moment it starts, so there is no step (JTC "replacement").
What a newer layer does not name keeps the older curve; a layer that no joint follows any more is dropped.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import inf

import numpy as np

from twind.motion.goal_options import JUMP, GoalTolerances, led_in
from twind.motion.time_scaling import TimeScaling
from twind.robot.arrays import Bools, Floats
from twind.robot.finding import Finding, ReasonCode
from twind.robot.joint_limits import JointLimits
from twind.robot.splines import Spline, interpolate
from twind.robot.trajectory import Reference, Trajectory

ROUNDING = 1e-9  # s: a tick this close to the end of a curve is at its end


@dataclass(frozen=True, slots=True, eq=False)
class MotionGoal:
    """An accepted trajectory and what was asked with it."""

    id: str
    path: Trajectory
    start: int  # tick
    tolerances: GoalTolerances | None
    goal_time: float | None  # s after the end within which the goal tolerances must be met; None, 0: ever
    foreseen: Floats | None = None  # rad, (n,), where it was to begin when it was judged; None: at once

    @property
    def judged_at_end(self) -> bool:
        """Its end is judged by where the joints really are."""
        return self.tolerances is not None and bool((self.tolerances.goal != inf).any())


@dataclass(frozen=True, slots=True, eq=False)
class MotionLayer:
    """A goal that has begun, and the joints that follow it."""

    goal: MotionGoal
    curve: Spline
    joints: Bools  # (n,)
    whole: bool  # all of them
    period: float  # s
    pace: TimeScaling = field(default_factory=TimeScaling)  # shared by what is left of it when joints leave

    def elapsed(self, tick: int) -> float:
        """Time on the curve, s; exactly its duration when within rounding of it. Ticks to come are whole."""
        t = (tick - self.goal.start - self.pace.lag) * self.period
        duration = self.curve.duration
        return duration if abs(t - duration) <= ROUNDING else t

    def is_finished(self, tick: int) -> bool:
        """The end of the curve has been reached."""
        return self.elapsed(tick) >= self.curve.duration

    def reference_at(self, tick: int) -> Reference:
        """The reference on the curve; at rest on its last point after the end."""
        reference = self.curve.sample(self.elapsed(tick))
        assert reference is not None  # a layer is never asked about a time before its start
        return reference if self.pace.even else self.pace.scale_reference(reference, self.period)

    def outside(self, error: Floats, bound: Floats) -> Bools:
        """Joints (n,) of the goal whose `error` is beyond `bound`; inf bounds nothing."""
        out: Bools = ~(error <= bound) & (bound != inf) & self.goal.path.commanded
        return out

    def fraction(self, tick: int) -> float:
        """How far it has come, 0..1."""
        duration = self.curve.duration
        return min(1.0, self.elapsed(tick) / duration) if duration > 0.0 else 1.0


def displaced(goal: MotionGoal, reference: Reference) -> Finding | None:
    """Why a goal that waited for its start cannot begin here: it was judged from another place."""
    if goal.foreseen is None:
        return None
    off = np.where(goal.path.commanded, np.abs(goal.foreseen - reference.position), 0.0)
    if (off <= JUMP).all():
        return None
    joint = int(np.argmax(off))
    message = "rad from where it was to begin: what moved before was slowed down"
    return Finding(ReasonCode.START_JUMP, joint, value=float(off[joint]), bound=JUMP, message=message)


def begun(goal: MotionGoal, reference: Reference, limits: JointLimits, period: float) -> MotionLayer:
    """The layer of a goal that starts now, from `reference`."""
    curve = interpolate(led_in(goal.path, reference, limits, period), reference)
    joints = goal.path.commanded
    return MotionLayer(goal, curve, joints, bool(joints.all()), period)


def without(layers: Sequence[MotionLayer], joints: Bools) -> list[MotionLayer]:
    """The layers after `joints` (n,) have left them; those left by all are gone."""
    left = []
    for layer in layers:
        keeps = layer.joints & ~joints
        if keeps.any():
            left.append(replace(layer, joints=keeps, whole=bool(keeps.all())))
    return left


def laid_over(base: Reference, layers: Sequence[MotionLayer], tick: int) -> Reference:
    """`base`, with the joints of each layer taken from it."""
    for layer in layers:
        base = choose(layer.joints, layer.reference_at(tick), base)
    return base


def choose(joints: Bools, theirs: Reference, others: Reference) -> Reference:
    """`theirs` for `joints` (n,), `others` for the rest."""
    return Reference(
        np.where(joints, theirs.position, others.position),
        np.where(joints, theirs.velocity, others.velocity),
        np.where(joints, theirs.acceleration, others.acceleration),
    )
