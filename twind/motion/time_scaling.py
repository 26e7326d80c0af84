"""Slowing of a motion along an unchanged path: its own time advances by a share of each tick. Pure.

On a curve c at pace p a joint has velocity c' p and acceleration c'' p² + c' dp/dt. A change of pace costs
acceleration. It takes as long as the joint with the least reserve needs.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from twind.robot.arrays import Bools, Floats
from twind.robot.finding import ReasonCode
from twind.robot.joint_limits import JointLimits
from twind.robot.splines import Spline
from twind.robot.trajectory import Reference

HALVINGS = 6  # of a change of pace that needs too much acceleration, before it waits for the next tick
ROUNDING = 1e-9  # of an acceleration limit
STANDING = 1e-9  # rad/s: slower costs nothing to slow down


@dataclass(frozen=True, slots=True)
class Stretch:
    """Duration of an accepted path, and what its motion took beyond it so far."""

    duration: float  # s
    added: float  # s
    reasons: tuple[ReasonCode, ...]  # in the order in which they occurred first


@dataclass(slots=True, eq=False)
class TimeScaling:
    """Pace of the time of one motion: 1 as the clock, 0 stopped."""

    now: float = 1.0
    change: float = 0.0  # by the last tick
    lag: float = 0.0  # ticks lost so far
    missed: int = 0  # ticks that did not occur
    reasons: list[ReasonCode] = field(default_factory=list)  # of both, each once

    @property
    def even(self) -> bool:
        """True when the pace is 1 and was 1 the tick before."""
        return self.now == 1.0 and self.change == 0.0

    def step(self, to: float) -> None:
        """Advance one tick at pace `to`."""
        self.change = to - self.now
        self.now = to
        self.lag += 1.0 - to

    def blame(self, reasons: Iterable[ReasonCode]) -> None:
        """Add reasons for lost time."""
        self.reasons += [code for code in reasons if code not in self.reasons]

    def scale_reference(self, reference: Reference, period: float) -> Reference:
        """Return the reference at this pace from one on the curve."""
        return Reference(
            reference.position,
            reference.velocity * self.now,
            reference.acceleration * (self.now * self.now) + reference.velocity * (self.change / period),
        )


def next_pace(
    curve: Spline,
    joints: Bools,
    at: float,
    pace: TimeScaling,
    wanted: float,
    limits: JointLimits,
    period: float,
) -> float:
    """Return the pace of the next tick, nearer to `wanted`, `at` s after the start.

    `joints` (n,) follow the curve.

    The positions of the last tick, of now and of the next one never need more than a joint's acceleration.
    The curve itself may need more at the knots of straight lines: there the pace stays.
    """
    if wanted == pace.now or at - pace.now * period < 0.0:
        return pace.now
    here = curve.sample(at)
    assert here is not None  # a motion that has begun
    least, most = _room(here, joints, pace.now, limits)
    change = min(max(wanted - pace.now, least * period), most * period)
    before = _place(curve, at - pace.now * period)
    allowed = limits.acceleration * (period * period) * (1.0 + ROUNDING)
    for _ in range(HALVINGS):
        bend = np.abs(_place(curve, at + (pace.now + change) * period) - 2.0 * here.position + before)
        if bool((bend <= allowed)[joints].all()):
            return pace.now + change
        change /= 2.0
    return pace.now


def _room(here: Reference, joints: Bools, pace: float, limits: JointLimits) -> tuple[float, float]:
    """Return how fast the pace may fall and rise, 1/s, with the acceleration that the curve leaves."""
    speed = np.abs(here.velocity)
    moving = joints & (speed > STANDING)
    if not moving.any():
        return -np.inf, np.inf
    speed = speed[moving]
    limit = limits.acceleration[moving]
    along = (here.acceleration * np.sign(here.velocity))[moving] * (pace * pace)
    least = float(((-limit - along) / speed).max())
    most = float(((limit - along) / speed).min())
    return min(least, 0.0), max(most, 0.0)


def _place(curve: Spline, at: float) -> Floats:
    reference = curve.sample(max(at, 0.0))
    assert reference is not None
    return reference.position
