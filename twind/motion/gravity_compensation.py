"""Offset of goals that holds a soft robot up: torque of gravity over stiffness, within bounds. Pure.

The guard judges the goal with its offset. The sum stays within the joint's limits, and moves in a tick at
most as far as the joint's velocity allows, so an offset never causes STEP_LIMIT and never hides one. Its
acceleration is not bounded: at a limit of the joint, and under a load that jumps, it changes within a tick.
"""

import numpy as np

from twind.robot.actuator_ratings import ActuatorRatings
from twind.robot.arrays import Floats
from twind.robot.joint_limits import JointLimits
from twind.robot.trajectory import Reference
from twind.safety.guard_types import Fence
from twind.safety.lead_rules import TorqueAtRest

RAMP = 1.0  # s from none to whole, and back
FOLLOW_SHARE = 0.5  # of the bound of FOLLOW_ERR that an offset may use
FASTEST = 0.5  # rad/s at which an offset changes: an arm of 0.2 rad sag turned at 2 rad/s needs 0.4


class GravityCompensation:
    """Offsets (n,), rad, of the goals of one robot. Remembers the offset of the last goal that left."""

    def __init__(self, at_rest: TorqueAtRest, rated: ActuatorRatings, follow: Floats) -> None:
        """`rated`, `follow`: as for `limit`."""
        self._at_rest = at_rest
        self.limit(rated, follow)
        self._offset = np.zeros(len(follow))
        self._proposed = self._offset
        self._wire: Floats | None = None  # the last goal that was proposed
        self._share = 0.0  # of the offset, 0 to 1
        self._steady = False  # the offset is that of the last pose, whole
        self._sag = np.zeros(len(follow))

    def reset(self) -> None:
        """Begin anew: the last goal that left had no offset."""
        self._offset = np.zeros(len(self._most))
        self._proposed = self._offset
        self._wire = None
        self._share = 0.0
        self._steady = False

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
        change = period / RAMP if active else -period / RAMP
        self._share = min(max(self._share + change, 0.0), 1.0)
        goal = reference.position
        if self._steady and active and np.array_equal(goal, self._pose):
            self._wire = goal + last
            return Reference(self._wire, reference.velocity, reference.acceleration)
        wanted = self._share * self._sag_at(goal) if self._share > 0.0 else np.zeros(len(last))
        most = FASTEST * period
        wanted = np.minimum(np.maximum(wanted, last - most), last + most)
        # A goal outside the limits gets an offset inwards only.
        wanted = np.maximum(wanted, np.minimum(limits.lower - goal, 0.0))
        wanted = np.minimum(wanted, np.maximum(limits.upper - goal, 0.0))
        if written is not None:
            reach = limits.velocity * period
            nearest = np.minimum(np.maximum(goal + wanted, written - reach), written + reach) - goal
            usual = np.abs(goal - (written - last)) <= reach
            wanted = np.where(usual, nearest, last)
        self._steady = self._share >= 1.0 and np.array_equal(wanted, last)
        self._proposed = wanted
        self._wire = goal + wanted
        return Reference(self._wire, reference.velocity, reference.acceleration)

    def _sag_at(self, pose: Floats) -> Floats:
        """Return the offset (n,), rad, that holds `pose` (n,); worked out again only for another pose."""
        if not np.array_equal(pose, self._pose):
            sag = self._at_rest(pose) / self._stiffness
            sag[np.isnan(sag)] = 0.0
            self._sag = np.minimum(np.maximum(sag, -self._most), self._most)
            self._pose = pose.copy()
        return self._sag
