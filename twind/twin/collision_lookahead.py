"""Look-ahead on the commanded path: the least clearance just ahead (LOOKAHEAD_COLLISION).

Loop's process, and the check of a policy.

The path is checked for the time that the robot needs to brake. While it stays the same, only the newly
reached time is checked, for several ticks at once; when it changes, all of it again. Poses that one earlier
measurement proves to be clear are not measured. A robot that holds costs nothing.
"""

from __future__ import annotations

from collections import deque
from math import ceil, inf, nan

import numpy as np

from twind.motion.predicted_path import LookaheadPlan
from twind.motion.trajectory_executor import TrajectoryExecutor
from twind.robot.arrays import Floats, Ints
from twind.robot.finding import Finding
from twind.robot.joint_limits import JointLimits
from twind.robot.modes import Motion
from twind.safety.guard_types import ClearanceAhead
from twind.twin.binding import Binding
from twind.twin.clearance_bound import REACH, ClearanceBound
from twind.twin.collision_model import CollisionModel

LEAST = 0.3  # s of the look-ahead at least
MOST = 1.0  # s at most: a joint that needs longer to brake is checked for this time only
POSES = 30  # poses checked in one tick at most: 0.2 to 0.3 ms of the tick
BATCH = 5  # poses of an unchanged path that are checked at once, beyond the time that counts
PATIENCE = 10  # ticks before a bound that proved too little is measured again
NEAR = 0.02  # m: distances are computed up to here; a smaller value is faster
NEARER = 1e-4  # m: a pair that comes nearer by less than this counts as not approaching ...
CREEPING = 2e-6  # m: ... but below `block` only until it has come nearer by that in several ticks
LEAP = 0.01  # rad: a reference further from that of the last look has not crept there
CLEAR = ClearanceAhead(inf)


class CollisionLookahead:
    """Look-ahead that keeps only the poses of the path where bodies come near. Distances are (p,), m."""

    def __init__(
        self, bodies: CollisionModel, far: CollisionModel, limits: JointLimits, period: float
    ) -> None:
        """`far`: the same bodies, measured up to `clearance_bound.REACH`. `period`: s, of a tick."""
        self._bodies = bodies
        self._far = far
        self._limits = limits
        self._period = period
        brakes = float((limits.velocity / limits.acceleration).max(initial=0.0))
        ticks = ceil(min(max(brakes, LEAST), MOST) / period - 1e-9)
        self._stride = ceil(ticks / POSES)
        self._ticks = np.arange(ticks, 0, -self._stride)[::-1]  # from now; the last is the farthest
        self.times: Floats = self._ticks.astype(np.float64) * period
        self._later = self._ticks[-1] + self._stride * np.arange(BATCH)  # the next ones of an unchanged path
        self._watch_distance = bodies.block + bodies.band
        self._bound = ClearanceBound(far, self._watch_distance)
        # m, (p,): the farthest that each pair was since it is near; -inf: not known
        self._farthest = np.full(len(self._watch_distance), -inf)
        self._looked_at: Floats | None = None  # the reference then
        self._tick = self._due = self._patient = 0
        self._way: tuple[object, ...] | None = None
        self._near: deque[tuple[int, Floats]] = deque()  # tick when it is reached, distances

    @classmethod
    def of(cls, binding: Binding, period: float) -> CollisionLookahead | None:
        """Return the look-ahead of a robot, or None without body pairs that can collide.

        Raises InvalidInput for names in `collision:` that the model lacks.
        """
        bodies = CollisionModel(binding, NEAR)
        if not bodies.pairs:
            return None
        return cls(bodies, bodies.reaching(REACH), binding.limits, period)

    def within(self, limits: JointLimits) -> CollisionLookahead:
        """Return a look-ahead with the same bodies and new limits, for a robot at rest."""
        return CollisionLookahead(self._bodies, self._far, limits, self._period)

    def look(self, executor: TrajectoryExecutor) -> ClearanceAhead | None:
        """Return the least clearance just ahead among approaching pairs; None while nothing moves.

        The clearance is NaN where a pose is not finite.
        """
        plan = executor.plan
        if plan is None or executor.motion not in (Motion.ACTIVE, Motion.STREAMING):
            self._way = None
            return None
        self._tick += 1
        way = plan.way
        new = way != self._way
        if new:
            self._near.clear()
        if new or self._tick >= self._due:
            ticks = self._ticks if new else self._later
            times: Floats = ticks.astype(np.float64) * self._period
            poses = plan.course(self._limits, times)
            if not np.isfinite(poses).all():
                self._way = None
                return ClearanceAhead(nan, float(self.times[-1]))
            self._take(poses, ticks)
            self._way = way
            self._due = self._tick + self._stride * (1 if new else BATCH)
        while self._near and self._near[0][0] <= self._tick:
            self._near.popleft()
        counted = self._tick + int(self._ticks[-1])
        near = [each for each in self._near if each[0] <= counted]
        return self._tightest(plan, near) if near else CLEAR

    def refuses(
        self, executor: TrajectoryExecutor, joints: Ints, position: Floats, velocity: Floats | None
    ) -> tuple[Finding, ...]:
        """Return the refusal of a streamed setpoint (m,) after which no path to rest is clear.

        Empty: none.

        A pair that is too close already may not come nearer.
        """
        plan = executor.plan
        if plan is None:
            return ()
        poses = plan.halting(joints, position, velocity, self._limits, self._period, self.times)
        if np.isfinite(poses).all():
            unproven = poses[self._unproven(poses)]
            if not len(unproven):
                return ()
            least = self._measured(unproven).min(axis=0)
        else:
            least = np.full(len(self._watch_distance), nan)
        if (least > self._bodies.block).all():
            return ()
        pairs = self._approaching(plan, least)
        spare = np.nan_to_num((least - self._bodies.block)[pairs], nan=-inf)
        if not len(pairs) or spare.min() > 0.0:
            return ()
        pair = int(pairs[spare.argmin()])
        closest = self._bodies.pairs[pair]
        block = float(self._bodies.block[pair])
        reason = f"{closest.name}: m between them if it went on and had to stop at once"
        return (Finding(closest.code, value=float(least[pair]), bound=block, message=reason),)

    def _take(self, poses: Floats, ticks: Ints) -> None:
        """Check the poses (k, n), `ticks` (k,) from now; keep those in which a pair is near."""
        unproven = self._unproven(poses)
        if not len(unproven):
            return
        rows = self._measured(poses[unproven])
        for k in np.flatnonzero((rows < self._watch_distance).any(axis=1)):
            self._near.append((self._tick + int(ticks[unproven[k]]), rows[k]))

    def _unproven(self, poses: Floats) -> Ints:
        """Return which of `poses` (k, n) must be measured: the others are proven to be clear."""
        bound = self._bound
        unproven = np.flatnonzero(~bound.clear(poses))
        if len(unproven) and self._tick >= self._patient:
            bound.measure(poses[unproven[len(unproven) // 2]])
            unproven = np.flatnonzero(~bound.clear(poses))
            self._patient = self._tick + (PATIENCE if len(unproven) else 0)
        return unproven

    def _measured(self, poses: Floats) -> Floats:
        """Return the distances (k, p), m; those of boxes only where they can be near on this path."""
        bodies = self._bodies
        rows = bodies.distances(poses)
        boxes = bodies.boxes
        if not len(boxes):
            return rows
        last = np.array([bodies.between(pair, 1.0) for pair in boxes])  # bodies are at that pose already
        rows[-1, boxes] = np.minimum(last, bodies.reach)
        turned = np.abs(poses - poses[-1]).max(axis=0)
        doubtful = boxes[~(last - bodies.levers[boxes] @ turned > self._watch_distance[boxes])]
        for k in range(len(poses) - 1) if len(doubtful) else ():
            bodies.place(poses[k])
            rows[k, doubtful] = [bodies.between(pair, bodies.reach) for pair in doubtful]
        return rows

    def _approaching(self, plan: LookaheadPlan, least: Floats) -> Ints:
        """Return the pairs that are near in the distances `least` (p,), m, and nearer than they are now.

        A slow stream comes nearer by less than `NEARER` with each setpoint: below `block` the sum of it
        counts. Bodies that overlap may be left by any way.
        """
        bodies = self._bodies
        near = np.flatnonzero(~(least >= self._watch_distance))
        here = plan.reference.position
        bodies.place(here)
        now = np.array([bodies.between(pair, bodies.reach) for pair in near.tolist()])
        if self._looked_at is None or not np.abs(here - self._looked_at).max() <= LEAP:
            self._farthest[:] = -inf
        self._looked_at = here
        self._farthest[near] = farthest = np.maximum(self._farthest[near], now)
        coming = least[near]
        creeping = (coming <= bodies.block[near]) & (coming <= np.minimum(now - CREEPING, farthest - NEARER))
        approaching: Ints = near[~(coming > now - NEARER) | (creeping & (farthest > 0.0))]
        return approaching

    def _tightest(self, plan: LookaheadPlan, near: list[tuple[int, Floats]]) -> ClearanceAhead:
        """Return the clearance with the least margin among the pairs that come nearer than they are now.

        `near`: ticks and distances of the poses that count.
        """
        bodies = self._bodies
        rows = np.array([row for _, row in near])
        least = rows.min(axis=0)
        pairs = self._approaching(plan, least)
        if not len(pairs):
            return CLEAR
        pair = int(pairs[(least - bodies.block)[pairs].argmin()])
        reached = near[int(rows[:, pair].argmin())][0]
        block = float(bodies.block[pair])
        ahead = max(reached - self._tick, 1) * self._period
        return ClearanceAhead(
            float(least[pair]), ahead, bodies.pairs[pair].bodies, block, block + bodies.band
        )
