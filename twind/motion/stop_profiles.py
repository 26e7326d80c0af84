"""Early end of a motion: the deceleration ramp, and the follower that never exceeds a limit.

Both advance one period per `step`, so a late tick delays them without a jump (LOOP_LATE).
"""

from dataclasses import replace

import numpy as np

from twind.exceptions import InvalidInput
from twind.robot.arrays import Bools, Floats, Ints, every, frozen
from twind.robot.joint_limits import JointLimits
from twind.robot.trajectory import Reference

ROUNDING = 1e-9  # of a step
RESTING = 1e-12  # rad and rad/s below which a joint counts as arrived: rounding, no motion


def require_braking(acceleration: Floats) -> None:
    """Refuse acceleration limits (n,) with which a joint never comes to rest. Raises InvalidInput."""
    brakes = acceleration > 0.0
    if not every(brakes):
        joint = int(np.argmin(brakes))
        limit = f"{acceleration[joint]:g} rad/s²"
        raise InvalidInput(f"joint {joint} cannot brake: its acceleration limit is {limit}, not above 0")


def still(position: Floats) -> Reference:
    """Return a reference at rest on `position` (n,), rad."""
    zero = frozen(np.zeros(len(position)))
    return Reference(frozen(position), zero, zero)


def stopping_point(reference: Reference, acceleration: Floats) -> Floats:
    """Return where each joint (n,) comes to rest when it brakes now, rad: p ± v²/(2a).

    A joint without a known velocity rests where it is.
    """
    velocity = np.nan_to_num(reference.velocity, posinf=0.0, neginf=0.0)
    return reference.position + velocity * np.abs(velocity) / (2.0 * acceleration)


TIME_ROUNDING = 1e-9  # s: above the rounding of tick times, below anything a motion shows


class StopRamp:
    """Stop of all joints: each brakes with its acceleration limit and then holds; from rest a plain hold."""

    def __init__(self, reference: Reference, limits: JointLimits, period: float) -> None:
        """Raises InvalidInput where a joint cannot brake."""
        require_braking(limits.acceleration)
        self._velocity = np.nan_to_num(reference.velocity, posinf=0.0, neginf=0.0)
        self._acceleration = np.copysign(limits.acceleration, self._velocity)
        self._lasts = np.abs(self._velocity) / limits.acceleration
        # `step` and `ahead` sum the same times in another order. Without a margin one may see the last
        # instant of braking, with its acceleration, and the other rest: the gate would judge another curve.
        self._ends = self._lasts - TIME_ROUNDING
        self._from = reference.position
        self._period = period
        self._steps = 0
        self._rest = still(stopping_point(reference, limits.acceleration))
        self.duration = float(self._lasts.max(initial=0.0))  # s until every joint rests

    @property
    def resting(self) -> bool:
        """True when the ramp is over: `step` gives the same position for ever."""
        return self._steps * self._period >= self.duration - TIME_ROUNDING

    def reference_at(self, t: float) -> Reference:
        """Return the reference `t` s after the ramp began."""
        if t >= self.duration - TIME_ROUNDING:
            return self._rest
        s = np.minimum(t, self._lasts)
        brakes = s < self._ends
        return Reference(
            np.where(
                brakes,
                self._from + s * (self._velocity - 0.5 * self._acceleration * s),
                self._rest.position,
            ),
            np.where(brakes, self._velocity - self._acceleration * s, 0.0),
            np.where(brakes, -self._acceleration, 0.0),
        )

    def step(self) -> Reference:
        """Advance by one period and return the reference."""
        if not self.resting:
            self._steps += 1
        return self.reference_at(self._steps * self._period)

    def ahead(self, t: float) -> Reference:
        """Return the reference `t` s from now, without advancing."""
        return self.reference_at(self._steps * self._period + t)


def stopping_speed(distance: Floats, gain: Floats, period: float) -> Floats:
    """Return the fastest speed, rad/s, that whole steps of `period` s brake within `distance`, rad.

    Arrays are (n,) or (k, n). `gain`: rad/s that a step takes off. n steps of v, v - aT, v - 2aT ... cover
    nvT - n(n - 1)aT²/2; the least n that still brakes counts.
    """
    covered = np.maximum(distance, 0.0) / period  # rad/s: what one step alone would need
    count = np.maximum(np.ceil(np.sqrt(0.25 + 2.0 * covered / gain) - 0.5 - ROUNDING), 1.0)
    return covered / count + 0.5 * (count - 1.0) * gain


class LimitedFollower:
    """Follows a target that may change at any time, within velocity, acceleration and position limits.

    Each step takes the largest velocity from which the joint can still stop at its target, and before its
    position limit, in whole periods. A target that is too fast is followed late, never by a jump.
    """

    def __init__(self, reference: Reference, limits: JointLimits, period: float) -> None:
        """Raises InvalidInput where a joint cannot brake."""
        require_braking(limits.acceleration)
        self._limits = limits
        self.acceleration = limits.acceleration  # rad/s², (n,)
        self.period = period  # s
        self._gain = limits.acceleration * period  # rad/s: what velocity may change in one step
        self._position = reference.position.copy()
        self._velocity = reference.velocity.copy()
        self._target = stopping_point(reference, limits.acceleration)
        self._drift = np.zeros(len(self._target))
        self._last = reference
        self._share = 1.0
        # rad, (n,) each: where goals stop, besides the limits; a goal beyond it is not pulled back
        self.fence: tuple[Floats, Floats] | None = None

    @property
    def resting(self) -> bool:
        """True when it has arrived at a target that stands still."""
        away = np.abs(self._target - self._position).max(initial=0.0)
        speed = np.abs(self._velocity).max(initial=0.0) + np.abs(self._drift).max(initial=0.0)
        return bool(away <= RESTING and speed <= RESTING)

    def set_target(self, target: Floats, drift: Floats) -> None:
        """Set a new target (n,) in rad, which moves by itself with `drift` (n,) in rad/s."""
        self._target = target.copy()
        self._drift = drift.copy()

    def set_joint_targets(self, joints: Ints, target: Floats, drift: Floats | float) -> None:
        """Set the targets (m,) of some `joints` (indices) alone."""
        self._target[joints] = target
        self._drift[joints] = drift

    def halt(self, joints: Bools) -> None:
        """Let `joints` (n,) brake from now on, and hold where that ends."""
        place = stopping_point(self._last, self.acceleration)
        self._target[joints] = place[joints]
        self._drift[joints] = 0.0

    @property
    def target(self) -> Floats:
        """Target, rad, (n,)."""
        return self._target

    @property
    def drift(self) -> Floats:
        """Speed of the target itself, rad/s, (n,)."""
        return self._drift

    def step(self, share: float = 1.0) -> Reference:
        """Advance by one period, at no more than `share` of the velocity limit, and return the reference."""
        limits = self._limits
        period = self.period
        before = self._velocity
        fastest = limits.velocity * share
        self._share = share
        away = self._target - self._position
        wanted = self._drift + np.copysign(stopping_speed(np.abs(away), self._gain, period), away)
        lower = limits.lower if self.fence is None else np.maximum(limits.lower, self.fence[0])
        upper = limits.upper if self.fence is None else np.minimum(limits.upper, self.fence[1])
        up = stopping_speed(upper - self._position, self._gain, period)
        down = stopping_speed(self._position - lower, self._gain, period)
        wanted = np.minimum(np.maximum(wanted, -np.minimum(fastest, down)), np.minimum(fastest, up))
        # The acceleration limit comes last: it holds even where the target is reached too late for it.
        self._velocity = np.minimum(np.maximum(wanted, before - self._gain), before + self._gain)
        self._position = self._position + self._velocity * period
        self._target = np.minimum(np.maximum(self._target + self._drift * period, limits.lower), limits.upper)
        self._last = Reference(self._position, self._velocity, (self._velocity - before) / period)
        return self._last

    def is_fenced(self, joint: int) -> bool:
        """Check that the fence keeps a joint from its target."""
        if self.fence is None:
            return False
        lowest, highest = self.fence
        return not lowest[joint] <= self._target[joint] <= highest[joint]

    def lag(self) -> tuple[Floats, Floats, Floats]:
        """Return how far each joint (n,) is behind its target and may be, rad, and its speed limit, rad/s.

        It may be behind by the way that it needs to stop at a target that goes on with its drift.
        """
        away = self._target - self._position
        closing = (self._velocity - self._drift) * np.sign(away)
        stopping = np.maximum(closing, 0.0) ** 2 / (2.0 * self._limits.acceleration)
        return np.abs(away), stopping, self._limits.velocity * self._share

    def ahead(self, t: float) -> Reference:
        """Return the reference `t` s from now, without advancing."""
        copy = LimitedFollower(self._last, self._limits, self.period)
        copy.set_target(self._target, self._drift)
        reference = self._last
        for _ in range(round(t / self.period)):
            if copy.resting:  # nothing more changes, however far ahead
                break
            reference = copy.step()
        return reference

    def onwards(self, share: float = 1.0) -> Reference:
        """Return the result of the next `step`, without advancing."""
        copy = LimitedFollower(self._last, self._limits, self.period)
        copy.set_target(self._target, self._drift)
        return copy.step(share)


class CompliantFollower(LimitedFollower):
    """Follower of measured instead of commanded positions, up to the hard limits.

    The other joints come to rest as from any stop. Each joint is aimed once: the load that pushed it there
    would push it on. `aim_at` aims anew.
    """

    def __init__(
        self, reference: Reference, limits: JointLimits, period: float, *, speed: float = np.inf
    ) -> None:
        """`speed`, rad/s, is an upper bound besides each joint's limit."""
        self.joints: Bools = np.zeros(len(reference.position), np.bool_)  # (n,), aimed at measured positions
        least = limits.hard_lower
        most = limits.hard_upper
        slow = replace(limits, lower=least, upper=most, velocity=np.minimum(limits.velocity, speed))
        super().__init__(reference, slow, period)

    def aim_at(self, joints: Bools, place: Floats) -> None:
        """Aim `joints` (n,) at `place` (n,), rad, within the hard limits; where that is NaN the aim stays."""
        limits = self._limits
        located = joints & np.isfinite(place)
        there = np.clip(place, limits.lower, limits.upper)
        self.set_target(np.where(located, there, self.target), np.zeros(len(place)))
        self.joints = self.joints | located
