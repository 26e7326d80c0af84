"""From an action to the joint target that is sent: smoothed, and never faster than the robot may.

The same code runs in simulation and in front of a robot, so that both see the same targets: they stay within
what the loop's own follower (`motion/stop_profiles.py`) follows unaltered.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twind.robot.arrays import Floats, frozen
from twind.robot.joint_limits import JointLimits

PERIOD = 0.02  # s, of a policy


@dataclass(frozen=True, slots=True)
class ActionShaping:
    """Settings by which actions are shaped. A policy must run with those it was trained with."""

    period: float = PERIOD  # s
    reach: float = 0.5  # rad that an action of 1 is from the default pose
    smoothing: float = 0.5  # of a small step of the target, this share is made in each period
    velocity_share: float = 0.9  # of each joint's velocity limit
    acceleration_share: float = 0.5  # of its acceleration limit
    margin: float = 0.01  # rad that targets keep from the position limits

    def __post_init__(self) -> None:
        """Raises ValueError: a figure outside what it can be."""
        shares = (self.smoothing, self.velocity_share, self.acceleration_share)
        if not all(0.0 < share <= 1.0 for share in shares):
            raise ValueError(f"smoothing and shares {shares} must be above 0 and at most 1")
        if not (self.period > 0.0 and self.reach > 0.0 and self.margin >= 0.0):
            raise ValueError(f"period {self.period} s, reach {self.reach} and margin {self.margin} rad")


class ActionShaper:
    """The targets of one robot, or of `shape` robots: arrays (…, n), in joint order.

    Each period a target goes `smoothing` of the way to its goal (a low-pass with one pole; 1: all of it), but
    never faster than it can brake in whole periods. Every goal lies within the limits, and so does every
    place where a target could come to rest.
    """

    def __init__(
        self, limits: JointLimits, default: Floats, shaping: ActionShaping, shape: tuple[int, ...] = ()
    ) -> None:
        """`default` (n,): the pose that actions count from, rad. Raises ValueError: beyond the limits."""
        if not ((default >= limits.lower) & (default <= limits.upper)).all():
            joint = int(np.argmax((default < limits.lower) | (default > limits.upper)))
            bounds = f"{limits.lower[joint]:g}..{limits.upper[joint]:g}"
            raise ValueError(f"joint {joint}: default pose {default[joint]:g} rad is outside {bounds}")
        least = np.minimum(limits.lower + shaping.margin, default)
        most = np.maximum(limits.upper - shaping.margin, default)
        self.shaping = shaping
        self.default = frozen(default)
        self.lower = frozen(np.maximum(least, default - shaping.reach))  # rad, (n,), of goals
        self.upper = frozen(np.minimum(most, default + shaping.reach))
        # Inside, speeds are counted in the most that one changes in a period, ways in what such a speed makes
        # in a period. From speed v, n periods of v, v - 1, v - 2 ... cover the way n v - n (n - 1) / 2.
        unit = limits.acceleration * shaping.acceleration_share * shaping.period**2
        self._unit = frozen(unit)
        self._per_second = frozen(unit / shaping.period)
        self._reach = frozen(shaping.reach / unit)
        self._least = frozen((self.lower - default) / unit)
        self._most = frozen((self.upper - default) / unit)
        self._fastest = frozen(limits.velocity * shaping.velocity_share * shaping.period / unit)
        self.target = np.broadcast_to(default, (*shape, len(default))).copy()  # rad, at the end of the period
        self.velocity = np.zeros_like(self.target)  # rad/s, through the period
        zeros = np.zeros_like(self.target)
        self._place = zeros.copy()
        self._speed = zeros.copy()
        self._way, self._size, self._count, self._work = (zeros.copy() for _ in range(4))

    def reset(self, target: Floats | None = None, at: Any = ...) -> None:
        """Begin at rest on `target` (…, n), the default pose if None; `at`: of these of several robots."""
        begin = self.default if target is None else target
        self.target[at] = begin
        self.velocity[at] = 0.0
        self._place[at] = (begin - self.default) / self._unit
        self._speed[at] = 0.0

    def coast(self, periods: int) -> None:
        """Move the targets by themselves for `periods` in which none was sent.

        The loop goes on with the velocity of its last setpoint; a goal at its limit stays there, at rest. A
        target that came so near to a limit that it cannot brake any more gets the fastest speed that can.
        """
        place = self._place
        speed = self._speed
        np.add(place, speed * periods, place)
        place.clip(self._least, self._most, place)
        room = np.where(speed > 0.0, self._most - place, place - self._least)
        fastest = np.zeros_like(room)
        _stopping_speed(room, np.zeros_like(room), fastest)
        np.copysign(np.minimum(np.abs(speed), fastest), speed, speed)
        np.multiply(speed, self._per_second, self.velocity)
        np.add(place * self._unit, self.default, self.target)

    def step(self, action: NDArray[Any]) -> tuple[Floats, Floats]:
        """The target (…, n) for the end of the next period, rad, and the velocity towards it, rad/s.

        The period begins at `target - velocity * period`, where the last one ended. Both arrays are the
        shaper's own: they change with the next step. An action beyond ±1 is one of ±1; NaN stays NaN.
        """
        place = self._place
        speed = self._speed
        way = self._way
        size = self._size
        work = self._work
        way[...] = action
        np.multiply(way, self._reach, way)
        np.maximum(way, self._least, out=way)  # in two: cheaper than `clip`
        np.minimum(way, self._most, out=way)
        np.subtract(way, place, way)
        np.abs(way, size)
        _stopping_speed(size, self._count, work)
        np.multiply(size, self.shaping.smoothing, size)
        np.minimum(work, size, out=work)
        np.minimum(work, self._fastest, out=work)
        np.copysign(work, way, work)
        np.subtract(work, speed, work)
        np.maximum(work, -1.0, out=work)
        np.minimum(work, 1.0, out=work)
        np.add(speed, work, speed)
        np.add(place, speed, place)
        np.multiply(place, self._unit, work)
        np.add(work, self.default, self.target)
        np.multiply(speed, self._per_second, self.velocity)
        return self.target, self.velocity


def _stopping_speed(way: Floats, count: Floats, out: Floats) -> None:
    """Set `out` to the fastest speed that is at rest after `way`, in the shaper's units; `count`: space."""
    np.multiply(way, 2.0, count)
    np.add(count, 0.25, count)
    np.sqrt(count, count)
    np.subtract(count, 0.5, count)
    np.ceil(count, count)
    np.maximum(count, 1.0, out=count)  # whole periods of braking
    np.divide(way, count, out)
    np.multiply(count, 0.5, count)
    np.add(out, count, out)
    np.subtract(out, 0.5, out)
