"""Proof that poses are clear, from the distances measured at one pose near them.

No point of a pair moves by more than the sum of lever x angle (`lever_bounds`), so its distance changes by no
more than that. While the robot stays near the measured pose no other measurement is needed.
"""

import numpy as np

from twind.robot.arrays import Bools, Floats, every
from twind.twin.collision_model import CollisionModel

REACH = 0.1  # m: range of the measurement; a larger one costs more than it saves (h24: 36 µs a pose)
ROUNDING = 1e-6  # m: of a measured distance


class ClearanceBound:
    """Lower bounds of all distances around one measured pose. Poses are (n,) or (k, n), rad."""

    def __init__(self, bodies: CollisionModel, watched: Floats) -> None:
        """`bodies` measures up to `REACH`. `watched`: m, (p,), distances above which a pair is clear."""
        self._bodies = bodies
        self._watched = watched + ROUNDING
        self._levers = np.ascontiguousarray(bodies.levers.T)
        self._pose: Floats | None = None
        self._spare = -self._watched  # m, (p,), at that pose

    def measure(self, pose: Floats) -> None:
        """Measure all distances at `pose` (n,)."""
        bodies = self._bodies
        self._pose = pose.copy()
        self._spare = bodies.distances(pose[None], bodies.boxes, bodies.reach)[0] - self._watched

    def clear(self, poses: Floats) -> Bools:
        """Return for each of `poses` (k, n) whether every pair is proven to be farther than watched."""
        if self._pose is None:
            return np.zeros(len(poses), np.bool_)
        turned = np.abs(poses - self._pose)
        if every(turned.max(axis=0) @ self._levers < self._spare):
            return np.ones(len(poses), np.bool_)
        within = turned @ self._levers < self._spare
        proven: Bools = np.count_nonzero(within, axis=1) == within.shape[1]
        return proven
