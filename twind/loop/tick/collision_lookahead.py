"""Look-ahead in every tick: the least clearance on the commanded path (LOOKAHEAD_COLLISION).

Loop's process.

The path is checked for the time that the robot needs to brake. While it stays the same, only the newly
reached time is checked; when it changes, all of it again. A robot that holds costs nothing.
"""

from __future__ import annotations

from collections import deque
from math import ceil, inf, nan
from typing import TYPE_CHECKING

import numpy as np

from twind.motion.predicted_path import LookaheadPlan
from twind.robot.arrays import Floats, Ints
from twind.robot.finding import Finding
from twind.robot.joint_limits import JointLimits
from twind.robot.modes import Motion
from twind.safety.guard_types import ClearanceAhead
from twind.twin.collision_model import CollisionModel

if TYPE_CHECKING:
    from twind.motion.trajectory_executor import TrajectoryExecutor

LEAST = 0.3  # s of the look-ahead at least
MOST = 1.0  # s at most: a joint that needs longer to brake is checked for this time only
POSES = 30  # poses checked in one tick at most: 0.2 to 0.3 ms of the tick
NEAR = 0.02  # m: distances are computed up to here; a smaller value is faster
NEARER = 1e-4  # m: a pair that comes nearer by less than this counts as not approaching
CLEAR = ClearanceAhead(inf)


class CollisionLookahead:
    """Look-ahead that keeps only the poses of the path where bodies come near. Distances are (p,), m."""

    def __init__(self, bodies: CollisionModel, limits: JointLimits, period: float) -> None:
        """`period`: s, of a tick."""
        self._bodies = bodies
        self._limits = limits
        self._period = period
        brakes = float((limits.velocity / limits.acceleration).max(initial=0.0))
        ticks = ceil(min(max(brakes, LEAST), MOST) / period - 1e-9)
        self._stride = ceil(ticks / POSES)
        self._ticks = np.arange(ticks, 0, -self._stride)[::-1]  # from now; the last is the farthest
        self.times: Floats = self._ticks.astype(np.float64) * period
        self._watch_distance = bodies.block + bodies.band
        self._tick = self._due = 0
        self._way: tuple[object, ...] | None = None
        self._near: deque[tuple[int, Floats]] = deque()  # tick when it is reached, distances

    def within(self, limits: JointLimits) -> CollisionLookahead:
        """Return a look-ahead with the same bodies and new limits, for a robot at rest."""
        return CollisionLookahead(self._bodies, limits, self._period)

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
            times = self.times if new else self.times[-1:]
            poses = plan.course(self._limits, times)
            if not np.isfinite(poses).all():
                self._way = None
                return ClearanceAhead(nan, float(times[-1]))
            self._take(poses)
            self._way = way
            self._due = self._tick + self._stride
        while self._near and self._near[0][0] <= self._tick:
            self._near.popleft()
        return self._tightest(plan) if self._near else CLEAR

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
        rows = (
            self._measured(poses)
            if np.isfinite(poses).all()
            else np.full((1, len(self._watch_distance)), nan)
        )
        least = rows.min(axis=0)
        if (least > self._bodies.block).all():
            return ()
        spare = self._spare(plan, least)
        pair = int(np.where(np.isnan(spare), -inf, spare).argmin())
        if spare[pair] > 0.0:
            return ()
        closest = self._bodies.pairs[pair]
        block = float(self._bodies.block[pair])
        reason = f"{closest.name}: m between them if it went on and had to stop at once"
        return (Finding(closest.code, value=float(least[pair]), bound=block, message=reason),)

    def _take(self, poses: Floats) -> None:
        """Check the poses (k, n) at the last k of `times`; keep those in which a pair is near."""
        rows = self._measured(poses)
        ticks = self._ticks[-len(poses) :]
        for k in np.flatnonzero((rows < self._watch_distance).any(axis=1)):
            self._near.append((self._tick + int(ticks[k]), rows[k]))

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

    def _spare(self, plan: LookaheadPlan, least: Floats) -> Floats:
        """Return the margin (p,) of the distances `least` above `block`, m.

        It is infinite where a pair comes no nearer.
        """
        now = self._measured(plan.reference.position[None])[0]
        return np.where(least > now - NEARER, inf, least - self._bodies.block)

    def _tightest(self, plan: LookaheadPlan) -> ClearanceAhead:
        """Return the clearance with the least margin among the pairs that come nearer than they are now."""
        bodies = self._bodies
        rows = np.array([row for _, row in self._near])
        least = rows.min(axis=0)
        spare = np.where(least < self._watch_distance, self._spare(plan, least), inf)
        pair = int(spare.argmin())
        if not spare[pair] < inf:
            return CLEAR
        reached = self._near[int(rows[:, pair].argmin())][0]
        block = float(bodies.block[pair])
        ahead = max(reached - self._tick, 1) * self._period
        return ClearanceAhead(
            float(least[pair]), ahead, bodies.pairs[pair].bodies, block, block + bodies.band
        )
