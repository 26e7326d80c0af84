"""Offset of goals that holds a soft robot up: torque of gravity over stiffness, within bounds. Pure.

The guard judges the goal with its offset. The sum stays within the joint's limits, and moves in a tick at
most as far as the joint's velocity allows, so an offset never causes STEP_LIMIT and never hides one. It
accelerates within the joint's limit, or as the goal itself does where that exceeds it: a goal that keeps the
limits of its joint keeps them with its offset.
"""

import numpy as np

from twind.motion.stop_profiles import stopping_speed
from twind.robot.actuator_ratings import ActuatorRatings
from twind.robot.arrays import Floats
from twind.robot.joint_limits import JointLimits
from twind.robot.trajectory import Reference
from twind.safety.guard_types import Fence
from twind.safety.lead_rules import TorqueAtRest

RAMP = 1.0  # s from none to whole, and back
FOLLOW_SHARE = 0.5  # of the bound of FOLLOW_ERR that an offset may use
FASTEST = 0.5  # rad/s at which an offset changes: an arm of 0.2 rad sag turned at 2 rad/s needs 0.4
REACHED = 1e-9  # rad: rounding


class GravityCompensation:
    """Offsets (n,), rad, of the goals of one robot. Remembers the offset of the last goal that left."""

    def __init__(self, at_rest: TorqueAtRest, rated: ActuatorRatings, follow: Floats) -> None:
        """`rated`, `follow`: as for `limit`."""
        self._at_rest = at_rest
        self.limit(rated, follow)
        self._offset = np.zeros(len(follow))
        self._proposed = self._offset
        self._still = np.zeros(len(follow))
        self._wire: Floats | None = None  # the last goal that was proposed, until it has left
        self._speed = self._still  # rad/s, of the last goal with its offset
        self._drift = self._still  # rad/s, of the last goal without it
        self._share = 0.0  # of the offset, 0 to 1
        self._steady = False  # the offset is that of the last pose, whole
        self._sag = self._still

    def reset(self) -> None:
        """Begin anew: the last goal that left had no offset, and stood still."""
        self._offset = np.zeros(len(self._most))
        self._proposed = self._offset
        self._wire = None
        self._stop()
        self._share = 0.0
        self._steady = False

    def _stop(self) -> None:
        """The goal stands still."""
        self._speed = self._still
        self._drift = self._still

    def limit(self, rated: ActuatorRatings, follow: Floats) -> None:
        """Use these gains and bounds from now on; the present offset goes over to the new one.

        `rated`: a joint of unknown stiffness gets no offset. `follow` (n,): rad, the bounds of FOLLOW_ERR.
        """
        self._stiffness = rated.stiffness
        self._most = np.minimum(FOLLOW_SHARE * follow, rated.lead)
        self._steady = False
        self._pose = np.full(len(follow), np.nan)  # of the last torque

    def offset(self, written: Floats | None) -> Floats:
        """Return the offset (n,), rad, in the last goal that left, `written`."""
        if written is not None and written is self._wire:
            self._offset = self._proposed
            self._wire = None
        return self._offset

    def fence_of_commands(self, fence: Fence) -> Fence:
        """Return where commands may go so that goals with their offset stay within `fence`, rad, (n,) each.

        The offset counts as it is and as it will be once it has faded in.
        """
        coming = self._sag if self._share > 0.0 else self._proposed
        lower, upper = fence
        return lower - np.minimum(self._proposed, coming), upper - np.maximum(self._proposed, coming)

    def compensate(
        self,
        reference: Reference,
        written: Floats | None,
        limits: JointLimits,
        period: float,
        *,
        active: bool,
    ) -> Reference:
        """Return `reference` with the offset of this tick.

        `written` (n,): rad, the last goal that left; `active` False: the offset fades out.
        """
        if written is None:
            self.reset()
        last = self.offset(written)
        if self._wire is not None:  # the last goal did not leave
            self._stop()
        change = period / RAMP if active else -period / RAMP
        self._share = min(max(self._share + change, 0.0), 1.0)
        goal = reference.position
        if self._steady and active and np.array_equal(goal, self._pose):
            self._stop()
            self._wire = goal + last
            return Reference(self._wire, reference.velocity, reference.acceleration)
        wanted = self._share * self._sag_at(goal) if self._share > 0.0 else self._still
        before = goal if written is None else written
        proposed = self._towards(wanted, goal, before, last, limits, period)
        self._steady = self._share >= 1.0 and np.array_equal(proposed, last)
        self._proposed = proposed
        self._wire = goal + proposed
        self._speed = (self._wire - before) / period
        return Reference(self._wire, reference.velocity, reference.acceleration)

    def _towards(
        self, wanted: Floats, goal: Floats, before: Floats, last: Floats, limits: JointLimits, period: float
    ) -> Floats:
        """Return the offset (n,) of `goal`, on its way from `last` to `wanted`.

        `before`: the last goal with its offset. The sum stops before the joint's limits, and last of all
        keeps its acceleration.
        """
        drift = (goal - (before - last)) / period
        pace = np.abs(drift)
        gain = limits.acceleration * period
        away = wanted - last
        up = np.maximum(limits.upper, goal) - before
        down = before - np.minimum(limits.lower, goal)
        nearing, rising, falling = stopping_speed(np.array((np.abs(away), up, down)), gain, period)
        speed = np.copysign(np.minimum(nearing, FASTEST), away)
        # A goal that accelerates against the offset leaves it nothing to brake with until its full speed.
        braking = limits.acceleration / (limits.velocity + pace + gain + FASTEST)
        speed = np.minimum(np.maximum(speed, -braking * (self._most + last)), braking * (self._most - last))
        speed = np.minimum(np.maximum(speed + drift, -falling), rising)
        change = drift - self._drift
        least = self._speed + np.minimum(change, -gain)
        most = self._speed + np.maximum(change, gain)
        offset = last + (np.minimum(np.maximum(speed, least), most) - drift) * period
        offset = np.where(np.abs(wanted - offset) <= REACHED, wanted, offset)
        self._drift = drift
        offset = self._bounded(offset, goal, before, last, limits, period)
        return np.where(pace <= limits.velocity + REACHED / period, offset, last)

    def _bounded(
        self, offset: Floats, goal: Floats, before: Floats, last: Floats, limits: JointLimits, period: float
    ) -> Floats:
        """Return `offset` within bounds that do not give way: after a reload, and for a goal that jumps."""
        offset = np.maximum(offset, np.minimum(last, -self._most))
        offset = np.minimum(offset, np.maximum(last, self._most))
        # A goal outside the limits gets an offset inwards only.
        offset = np.maximum(offset, np.minimum(limits.lower - goal, 0.0))
        offset = np.minimum(offset, np.maximum(limits.upper - goal, 0.0))
        reach = limits.velocity * period
        bounded: Floats = np.minimum(np.maximum(goal + offset, before - reach), before + reach) - goal
        return bounded

    def _sag_at(self, pose: Floats) -> Floats:
        """Return the offset (n,), rad, that holds `pose` (n,); worked out again only for another pose."""
        if not np.array_equal(pose, self._pose):
            sag = self._at_rest(pose) / self._stiffness
            sag[np.isnan(sag)] = 0.0
            self._sag = np.minimum(np.maximum(sag, -self._most), self._most)
            self._pose = pose.copy()
        return self._sag
