"""Rule LEAD_LIMIT: how far a goal may lead a joint whose device has no watchdog. Pure.

Such a device drives on to its last goal when the daemon dies, so the lead is the motion that remains. A goal
that was written is never pulled towards its joint: a soft joint under load would sink further with each pull.
A joint that keeps an older path beside a setpoint stream is bounded by FOLLOW_ERR only.
"""

from collections.abc import Callable, Sequence

import numpy as np

from twind.robot.actuator_ratings import ActuatorRatings
from twind.robot.arrays import Bools, Floats, Ints, every, some
from twind.robot.finding import Finding, ReasonCode
from twind.robot.joint_limits import JointLimits
from twind.robot.joint_state import JointState
from twind.robot.modes import Motion
from twind.robot.trajectory import Reference
from twind.safety.guard_types import (
    MOVING,
    NOTHING,
    REACTING,
    Fence,
    GuardInput,
    GuardThresholds,
    Reaction,
    RuleResult,
)

TorqueAtRest = Callable[[Floats], Floats]  # torque (n,), N·m, that holds a pose (n,), rad; NaN unknown
NEVER = np.inf  # s


class LeadRules:
    """Rule LEAD_LIMIT; memory: the joints that do not follow, and since when a motion waits for them."""

    def __init__(
        self,
        limits: JointLimits,
        rated: ActuatorRatings,
        bounds: GuardThresholds,
        at_rest: TorqueAtRest | None,
    ) -> None:
        """`at_rest`: None where no load is known; then every lead counts whole."""
        self._bounds = bounds
        self._at_rest = at_rest
        self._rows: Ints = np.flatnonzero(np.isfinite(rated.lead))  # (m,) joints without a watchdog
        self._most = rated.lead[self._rows]
        self._stiffness = rated.stiffness[self._rows]
        self._acceleration = limits.acceleration[self._rows]
        self._free = bounds.lead_free * self._most  # rad, below which nothing is slowed
        self._count = len(rated.lead)
        self._leading: Bools = np.zeros(len(self._rows), np.bool_)
        self._waits_since = NEVER  # s

    @property
    def applies(self) -> bool:
        """True for a robot with a device that has no watchdog."""
        return len(self._rows) > 0

    def judge(self, facts: GuardInput) -> Sequence[RuleResult]:
        """Return LEAD_LIMIT for a motion: slower, then waiting, then held; a fence for a setpoint stream.

        Never for a hold, a stop or the way to the rest pose.
        """
        goal = facts.goal
        measured = facts.measured
        moves = facts.motion in MOVING and facts.state not in REACTING
        if not (moves and facts.torque_held and facts.torque_settled) or goal is None or measured is None:
            self._forget()
            return NOTHING
        away = goal.position[self._rows] - measured.position[self._rows]
        later = away + self._coming(goal, measured)
        if facts.limp is not None:
            held = ~facts.limp[self._rows]
            away = away * held
            later = later * held
        if every(np.maximum(np.abs(away), np.abs(later)) <= self._free):
            self._forget()
            return NOTHING
        sag = self._sag(measured.position)
        lead = _beyond(away, sag)
        ahead = np.maximum(lead, _beyond(later, sag))
        self._follow_joints(goal.velocity[self._rows] * np.sign(later), ~(ahead <= self._free))
        if not some(self._leading):
            self._waits_since = NEVER
            return NOTHING
        if facts.motion is Motion.STREAMING:
            worst = self._worst(lead)
            fence = self._fence(goal, measured, sag)
            return (RuleResult(self._finding(worst, lead, "its setpoints are limited"), fence=fence),)
        return (self._paced(lead, ahead, facts.now),)

    def _coming(self, goal: Reference, measured: JointState) -> Floats:
        """Return how each goal gains on its joint while it brakes and the joint keeps its speed, rad (m,)."""
        speed = goal.velocity[self._rows]
        gains = speed - np.nan_to_num(measured.velocity[self._rows])
        closing = np.clip(gains, np.minimum(speed, 0.0), np.maximum(speed, 0.0))
        way: Floats = closing * np.abs(closing) / (2.0 * self._acceleration)
        return way

    def _sag(self, position: Floats) -> Floats:
        """Return goal minus position (m,), rad, of joints that hold their load at rest; 0 where unknown."""
        if self._at_rest is None:
            return np.zeros(len(self._rows))
        sag = self._at_rest(position)[self._rows] / self._stiffness
        return np.where(np.isfinite(sag), sag, 0.0)

    def _follow_joints(self, outward: Floats, near: Bools) -> None:
        """Note the joints near their limit whose goal moves away from them, or waits after it did."""
        begins = ~(outward <= 0.0)
        waits = self._leading & ~(outward < 0.0)
        self._leading = near & (begins | waits)

    def _paced(self, lead: Floats, ahead: Floats, now: float) -> RuleResult:
        """Return a slower pace for a motion, 0 at the limit of a joint, and HOLD if that lasts."""
        bounds = self._bounds
        room = (self._most - ahead) / (self._most - self._free)
        least = float(np.nan_to_num(room, nan=0.0)[self._leading].min())
        pace = least if least >= bounds.least_pace else 0.0
        self._waits_since = min(self._waits_since, now) if pace == 0.0 else NEVER
        worst = self._worst(ahead)
        if now - self._waits_since >= bounds.lead_for:
            finding = self._finding(
                worst,
                lead,
                f"holding, as the motion waited {bounds.lead_for:g} s near this bound: what blocks it?",
            )
            return RuleResult(finding, Reaction.HOLD, transient=True)
        return RuleResult(self._finding(worst, lead, "the motion is slower, or waits"), pace=pace)

    def _worst(self, lead: Floats) -> int:
        """Return the row of the leading joint that is farthest beyond its limit."""
        beyond = np.where(self._leading, np.nan_to_num(lead, nan=np.inf) - self._most, -np.inf)
        return int(np.argmax(beyond))

    def _finding(self, row: int, lead: Floats, what: str) -> Finding:
        message = f"its goal leads it, beyond the sag of its load, and it has no watchdog: {what}"
        joint = int(self._rows[row])
        bound = float(self._most[row])
        return Finding(ReasonCode.LEAD_LIMIT, joint, value=float(lead[row]), bound=bound, message=message)

    def _fence(self, goal: Reference, measured: JointState, sag: Floats) -> Fence:
        """Return the least and the largest goal (n,), rad; for an unknown position it is the goal."""
        lower = np.full(self._count, -np.inf)
        upper = np.full(self._count, np.inf)
        here = measured.position[self._rows]
        there = goal.position[self._rows]
        known = np.isfinite(here)
        lower[self._rows] = np.where(known, here + np.minimum(sag, 0.0) - self._most, there)
        upper[self._rows] = np.where(known, here + np.maximum(sag, 0.0) + self._most, there)
        return lower, upper

    def _forget(self) -> None:
        self._leading[:] = False
        self._waits_since = NEVER


def _beyond(away: Floats, sag: Floats) -> Floats:
    """Return how far `away` lies outside what the sag of a load explains, rad (m,)."""
    lead: Floats = np.abs(away - np.clip(away, np.minimum(sag, 0.0), np.maximum(sag, 0.0)))
    return lead
