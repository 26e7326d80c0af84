"""Largest torque that each joint holds at rest, from the model: over its range, in many poses.

The poses are drawn with a fixed seed, so that the result depends on the files alone.
"""

import numpy as np

from twind.robot.arrays import Floats
from twind.twin.binding import Binding
from twind.twin.dynamics import Dynamics

POSES = 64  # drawn, beside those of the robot file
SEED = 0


def worst_load(binding: Binding) -> Floats:
    """Return the largest torque (n,), N·m, that holds any of the poses; NaN for a robot without bodies."""
    count = len(binding.rest)
    if binding.robot.gate.collision.bodiless:
        return np.full(count, np.nan)
    limits = binding.limits
    share = np.random.default_rng(SEED).random((POSES, count))
    drawn = limits.lower + share * (limits.upper - limits.lower)
    named = [[pose[name] for name in binding.robot.names] for pose in binding.robot.poses.values()]
    dynamics = Dynamics(binding)
    loads = [np.abs(dynamics.at_rest(pose)) for pose in (*np.array(named), *drawn)]
    worst: Floats = np.max(loads, axis=0)
    return worst
