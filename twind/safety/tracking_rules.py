"""Rules on following commands: FOLLOW_ERR, SENSE_FROZEN, OVERSPEED and MIRROR_DRIFT. Pure.

A moving servo is behind its goal by the lag of its loop: FOLLOW_ERR allows for `GuardThresholds.lag` at the
goal's speed. Slow conditions are checked every `GuardThresholds.look`. An encoder belongs to an actuator:
where several actuators turn joints together, their angles are judged.
"""

from collections.abc import Iterator, Sequence
from math import isfinite

import numpy as np

from twind.robot.arrays import Bools, Floats, every, some
from twind.robot.finding import Finding, ReasonCode
from twind.robot.joint_limits import JointLimits
from twind.robot.joint_state import JointState
from twind.robot.transmission import MappedTransmission
from twind.safety.device_rules import ALERT, TRIPPED
from twind.safety.follow_bounds import FollowBounds
from twind.safety.goal_rules import ROUNDING
from twind.safety.guard_types import (
    MOVING,
    NOTHING,
    GuardInput,
    GuardThresholds,
    Reaction,
    RuleResult,
    hold,
    hold_here,
)

STILL = 1e-9  # rad, less than any count: no change, computed from joints
DRIFT = "rad between the robot and the simulation of its goals"  # what MIRROR_DRIFT measures
NEVER = np.inf  # s: start of a condition that does not hold


class TrackingRules:
    """Rules on following; memory per joint: start of an error or a drift, and the last change of position."""

    def __init__(
        self,
        limits: JointLimits,
        bounds: GuardThresholds,
        following: FollowBounds,
        linked: Sequence[MappedTransmission] = (),
    ) -> None:
        """`linked`: transmissions, whose actuators turn joints together."""
        count = len(limits.lower)
        self._linked = linked
        self._bounds = bounds
        self._following = following
        self._shares = 1.0 / following.rad  # 1/rad
        self._velocity = limits.velocity
        self._fastest = bounds.overspeed * limits.velocity + bounds.overspeed_slack
        self._slowest = float(self._fastest.min(initial=np.inf)) ** 2  # (rad/s)², of the slowest joint
        self._off_since, self._drift_since = np.full((2, count), NEVER)
        self._fast = np.zeros(count, np.int64)  # readings in a row
        self._place: Floats | None = None  # rad, of actuators, the last reading checked; None: nothing moves
        self._goal = np.zeros(count)  # rad, their goal when that last changed, ...
        self._turned = np.zeros(count)  # s, ... and when
        self._turning = np.zeros(count, np.bool_)  # at the last check the servo reported that it turns
        self._checked_at = -NEVER  # s
        self._suspect = False  # a joint is off its goal or too fast, or was so in its last reading
        self._forgotten = False  # nothing is remembered

    def judge(self, facts: GuardInput) -> Sequence[RuleResult]:
        """Return FOLLOW_ERR, SENSE_FROZEN, OVERSPEED and MIRROR_DRIFT, for a robot under own torque."""
        if not facts.torque_held and self._forgotten:
            return NOTHING
        return NOTHING if self._is_usual(facts) else tuple(self._found(facts))

    def _is_usual(self, facts: GuardInput) -> bool:
        """Check for joints that follow their goals, between two checks of slow conditions."""
        measured = facts.measured
        goal = facts.previous
        if measured is None or goal is None or not facts.torque_held or self._suspect:
            return False
        if not 0.0 <= facts.now - self._checked_at < self._bounds.look - ROUNDING:
            return False
        velocity = measured.velocity
        share = (measured.position - goal) * self._shares
        return bool(velocity.dot(velocity) <= self._slowest and share.dot(share) <= 1.0)

    def _found(self, facts: GuardInput) -> Iterator[RuleResult]:
        measured = facts.measured
        goal = facts.previous
        if measured is None or not facts.torque_held:
            self._forget()
            return
        self._forgotten = False
        velocity = measured.velocity
        if not velocity.dot(velocity) <= self._slowest or some(self._fast):
            yield from self._speeding(facts, measured)
        self._suspect = some(self._fast)
        if goal is None or not isfinite(goal.dot(goal)):  # nothing was written, or nothing valid
            self._off_since[:] = NEVER
            self._place = None
            return
        error = measured.position - goal
        share = error * self._shares
        if not share.dot(share) <= 1.0 or self._off_since.min() < NEVER:
            yield from self._lagging(facts, measured, np.abs(error))
        self._suspect = self._suspect or bool(self._off_since.min() < NEVER)
        if not 0.0 <= facts.now - self._checked_at < self._bounds.look - ROUNDING:
            self._checked_at = facts.now
            yield from self._frozen(facts, measured, goal)
            if facts.simulated is not None:
                yield from self._drifting(facts, measured, facts.simulated)

    # ------------------------------------------------------------------------------------------- FOLLOW_ERR

    def _lagging(self, facts: GuardInput, measured: JointState, off: Floats) -> Iterator[RuleResult]:
        """Yield FOLLOW_ERR: too far from the goal for too long, or much further.

        A joint that follows no goal must not make the others soft. Such a joint is limp (TORQUE_MISMATCH), or
        has a tripped watchdog (WATCHDOG_TRIPPED). While the robot is lowered, it may also have shut down
        (SERVO_ALERT) or restarted.
        """
        bounds = self._bounds
        if facts.goal is not None:
            off = off - bounds.lag * np.minimum(np.abs(facts.goal.velocity), self._velocity)
        bad = ~(off <= self._following.rad)
        if facts.torque_settled:
            bad &= (facts.torque != 0) & (facts.watchdog != TRIPPED)
        else:
            bad &= (facts.torque != 0) | ((facts.alerts & ALERT == 0) & (facts.watchdog != 0))
        far = bad & ~(off <= self._following.damp)
        self._off_since = _since(self._off_since, bad, measured.heard, facts.now)
        long = facts.now - self._off_since >= self._following.seconds - ROUNDING
        for joint in np.flatnonzero(measured.heard & (far | (bad & long))).tolist():
            yield self._off(facts, joint, float(off[joint]), bool(far[joint]))

    def _off(self, facts: GuardInput, joint: int, value: float, far: bool) -> RuleResult:
        bound = float((self._following.damp if far else self._following.rad)[joint])
        what = "soft from now on" if far else "held where it is"
        message = f"rad further from its goal than it may lag: {what}: what blocks it, its load, its gains?"
        finding = Finding(ReasonCode.FOLLOW_ERR, joint, value=value, bound=bound, message=message)
        return RuleResult(finding, Reaction.DAMP if far else hold_here(facts), latches=True, here=True)

    def _frozen(self, facts: GuardInput, measured: JointState, goal: Floats) -> Iterator[RuleResult]:
        """Yield SENSE_FROZEN: the same position while the goal moves and the motor works.

        A blocked motor is not frozen: its servo reports no speed, and it draws the current of a motor that
        pushes. A joint that comes loose after a rest turns before a count has passed, so two checks must see
        it.
        """
        if facts.motion not in MOVING:
            self._place = None
            return
        bounds = self._bounds
        place, goal, velocity = self._of_actuators(measured, goal)
        turning = np.abs(velocity) >= bounds.frozen_turning
        on = turning & self._turning
        self._turning = turning
        if self._place is None:
            changed = np.ones(len(goal), np.bool_)
        else:
            changed = ~(np.abs(place - self._place) <= STILL) | ~measured.heard
        self._place = place
        np.copyto(self._goal, goal, where=changed)
        self._turned[changed] = facts.now
        moved = np.abs(goal - self._goal)
        if every(moved < bounds.frozen_moved):
            return
        load = np.full(len(moved), np.nan) if facts.load is None else facts.load
        idle = (load >= bounds.frozen_load[0]) & (load <= bounds.frozen_load[1])
        works = ((moved >= bounds.frozen_moved) & on) | ((moved >= bounds.frozen_far) & idle)
        long = facts.now - self._turned >= bounds.frozen_for - ROUNDING
        for joint in np.flatnonzero(works & long & measured.heard).tolist():
            value = float(facts.now - self._turned[joint])
            bound = bounds.frozen_for
            message = "s with the very same position while its motor works: encoder, horn, gear?"
            finding = Finding(ReasonCode.SENSE_FROZEN, joint, value=value, bound=bound, message=message)
            yield RuleResult(finding, hold(facts), latches=True)

    def _of_actuators(self, measured: JointState, goal: Floats) -> tuple[Floats, Floats, Floats]:
        """Return positions, goals and velocities of the actuators (n,), rad and rad/s; NaN: unknown."""
        place = measured.position
        velocity = measured.velocity
        if self._linked:
            place = place.copy()
            goal = goal.copy()
            velocity = velocity.copy()
        for each in self._linked:
            each.angles(place)
            each.angles(goal)
            each.speeds(place, velocity)
        return place, goal, velocity

    # -------------------------------------------------------------------------------- OVERSPEED, MIRROR_DRIFT

    def _speeding(self, facts: GuardInput, measured: JointState) -> Iterator[RuleResult]:
        """Yield OVERSPEED: too fast in readings in a row."""
        speed = np.abs(measured.velocity)
        fast = ~(speed <= self._fastest)
        self._fast = np.where(measured.heard, np.where(fast, self._fast + 1, 0), self._fast)
        for joint in np.flatnonzero(measured.heard & (self._fast >= self._bounds.overspeed_row)).tolist():
            value = float(speed[joint])
            bound = float(self._fastest[joint])
            message = "rad/s, faster than it may turn: holding: what drives it, its gains?"
            finding = Finding(ReasonCode.OVERSPEED, joint, value=value, bound=bound, message=message)
            yield RuleResult(finding, hold(facts))

    def _drifting(
        self, facts: GuardInput, measured: JointState, simulated: JointState
    ) -> Iterator[RuleResult]:
        """Yield MIRROR_DRIFT: robot and simulation apart for a while. It is reported only."""
        apart = np.abs(measured.position - simulated.position)
        bad = ~(apart <= self._bounds.drift)
        if not some(bad):
            self._drift_since[:] = NEVER
            return
        self._drift_since = _since(self._drift_since, bad, measured.heard, facts.now)
        long = facts.now - self._drift_since >= self._bounds.drift_for - ROUNDING
        for joint in np.flatnonzero(bad & long).tolist():
            value = float(apart[joint])
            bound = self._bounds.drift
            message = f"{DRIFT}: calibration, load, gains?"
            yield RuleResult(
                Finding(ReasonCode.MIRROR_DRIFT, joint, value=value, bound=bound, message=message)
            )

    def _forget(self) -> None:
        self._off_since[:] = NEVER
        self._drift_since[:] = NEVER
        self._fast[:] = 0
        self._place = None
        self._forgotten = True
        self._suspect = False


def _since(since: Floats, bad: Bools, fresh: Bools, now: float) -> Floats:
    """Return since when (s) each joint is bad, as of its last reading; without a reading it stays."""
    begun = np.minimum(since, now)
    found: Floats = np.where(fresh, np.where(bad, begun, NEVER), since)
    return found
