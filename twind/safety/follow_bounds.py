"""Distance and time that each joint may be behind its goal (FOLLOW_ERR). Pure.

A position servo without feed-forward makes torque and speed from its error alone. At rest it is behind by
torque / stiffness, in motion by its speed × the lag of its loop. The guard allows for `GuardThresholds.lag`
of the goal's speed at every joint: only a longer lag widens a bound.
"""

from dataclasses import dataclass

import numpy as np

from twind.robot.actuator_ratings import ActuatorRatings
from twind.robot.arrays import Floats, frozen
from twind.robot.joint_limits import JointLimits
from twind.safety.guard_types import GuardThresholds

# Of the expected lag: friction, a supply below nominal and acceleration add to it, and no key states them.
MARGIN = 1.5
# rad: no bound is worked out beyond it; damping follows 0.3 rad further. The owner may write more.
MOST = 0.5


@dataclass(frozen=True, slots=True)
class FollowBounds:
    """Bounds per joint, (n,) each."""

    rad: Floats  # between position and permitted position of a joint ...
    seconds: Floats  # ... for so long
    damp: Floats  # rad: at once, and softer
    sag: Floats  # rad behind the goal at rest under the largest load; NaN: no gain or no model is known
    trail: Floats  # rad behind the goal at full speed, beyond the sag; NaN: no gain is known
    wanted: Floats  # rad, `MARGIN` times what the guard does not allow for anyway; NaN: unknown

    @property
    def lag(self) -> Floats:
        """Expected distance behind the goal in the worst case, rad (n,); NaN unknown."""
        total: Floats = self.sag + self.trail
        return total


def follow_bounds(
    rated: ActuatorRatings, limits: JointLimits, load: Floats | None, bounds: GuardThresholds
) -> FollowBounds:
    """Return the bounds of all joints: those of the owner, else worked out, never below the default.

    `load` (n,): N·m, the largest torque that holds the robot at rest; NaN or None: unknown.
    """
    torque = np.full(len(limits.lower), np.nan) if load is None else np.abs(load)
    sag = np.where(np.isnan(torque), np.nan, np.fmin(torque, limits.effort) / rated.stiffness)
    trail = limits.velocity * rated.lag
    beyond = limits.velocity * np.maximum(rated.lag - bounds.lag, 0.0)
    wanted = MARGIN * (sag + beyond)
    worked_out = np.clip(np.nan_to_num(wanted, nan=0.0), bounds.follow, max(MOST, bounds.follow))
    rad = np.where(np.isnan(rated.follow), worked_out, rated.follow)
    return FollowBounds(
        rad=frozen(rad),
        seconds=frozen(np.where(np.isnan(rated.follow_for), bounds.follow_for, rated.follow_for)),
        damp=frozen(rad + (bounds.follow_damp - bounds.follow)),
        sag=frozen(sag),
        trail=frozen(trail),
        wanted=frozen(wanted),
    )
