"""Rules on motion sources and written goals: ESTOP to STREAM_STALE, STEP_LIMIT, finite numbers. Pure."""

from collections.abc import Iterator, Sequence
from math import isfinite

import numpy as np

from twind.robot.arrays import Floats, every
from twind.robot.finding import Finding, ReasonCode
from twind.robot.joint_limits import JointLimits
from twind.robot.modes import Mode, Motion, RobotState
from twind.safety.guard_types import (
    MOVING,
    NOTHING,
    REACTING,
    GuardInput,
    GuardThresholds,
    Reaction,
    RuleResult,
    hold,
)
from twind.safety.state_machine import LATCHED

UNWRITABLE = (
    RobotState.IDENTIFYING,
    RobotState.CONNECTED,
    RobotState.CALIBRATING,
    RobotState.INHIBITED,
)  # no goal may leave in these states: torque is off, or not of this daemon
ROUNDING = 1e-9  # rad, of a goal that moves at exactly the velocity limit; for ticks and times too


class GoalRules:
    """Rules on goals and their source, without memory: each tick by itself."""

    def __init__(self, limits: JointLimits, bounds: GuardThresholds) -> None:
        self._limits = limits
        self._bounds = bounds
        self._period = 0.0  # s
        middle = 0.5 * (limits.hard_lower + limits.hard_upper)
        # (2, n) rad: where a goal is measured from, and how far from there it may be. The first row is the
        # last goal and one tick's way, the second one the hard limits.
        self._origin = np.tile(middle, (2, 1))
        self._reach = np.tile(limits.hard_upper - middle + bounds.beyond_hard, (2, 1))

    def judge(self, facts: GuardInput) -> Sequence[RuleResult]:
        """Return the results of all rules on goals and their source."""
        if self._is_usual(facts):
            return NOTHING
        return (*self.timing(facts), *self.authority(facts), *self.goal(facts))

    def _is_usual(self, facts: GuardInput) -> bool:
        """Check for a tick in time with a small step of a goal that may be written; no rule applies to it."""
        bounds = self._bounds
        if not facts.lateness <= bounds.late or facts.missed_in_a_row or not facts.lease_ok:
            return False
        goal = facts.goal
        if facts.motion is Motion.STREAMING or (goal is not None and facts.state in UNWRITABLE):
            return False
        if goal is None:
            return True
        position = goal.position
        return isfinite(float(position @ position)) and every(self._away(facts, position) <= self._reach)

    def _away(self, facts: GuardInput, goal: Floats) -> Floats:
        """Return how far the goal (n,) is from the last one and from the middle of its range, rad (2, n)."""
        if facts.period != self._period:
            self._period = facts.period
            # A larger step would drive the servo faster than the joint's limit (docs/proof.md).
            self._reach[0] = self._limits.velocity * facts.period + ROUNDING
        self._origin[0] = goal if facts.previous is None else facts.previous
        away: Floats = np.abs(goal - self._origin)
        return away

    def timing(self, facts: GuardInput) -> Iterator[RuleResult]:
        """Yield LOOP_LATE: late ticks are reported, too many missed ones hold.

        The executor re-times by itself.
        """
        bounds = self._bounds
        missed = facts.missed_in_a_row
        many = self.many_missed(missed, facts.period)
        if many is not None:
            # Missed ticks endanger only a robot. A simulation goes on later, as the executor counts ticks.
            reaction = hold(facts) if facts.mode is Mode.LIVE else Reaction.NONE
            yield RuleResult(many, reaction, transient=True)
        elif missed >= bounds.missed_warn:
            yield RuleResult(_late(missed, bounds.missed_warn, "ticks missed in a row"))
        elif not facts.lateness <= bounds.late:
            yield RuleResult(_late(facts.lateness, bounds.late, "s that the tick began late"))

    def many_missed(self, missed: int, period: float) -> Finding | None:
        """Return LOOP_LATE for so many ticks missed just before one that they hold a motion, or None."""
        most = max(float(self._bounds.missed_hold), self._bounds.missed_for / period)
        late = missed >= most - ROUNDING
        return _late(missed, most, "ticks missed in a row: holding") if late else None

    def authority(self, facts: GuardInput) -> Iterator[RuleResult]:
        """Yield ESTOP, LEASE_LOST, STREAM_STALE, and INTERNAL for a goal in a state that allows none."""
        if facts.goal is not None and facts.mode is Mode.LIVE and facts.state in UNWRITABLE:
            message = f"a goal while {facts.state.value}: nothing may be written"
            yield RuleResult(Finding(ReasonCode.INTERNAL, message=message), Reaction.INHIBIT, refuses=True)
        if facts.motion is Motion.STREAMING:
            age = facts.setpoint_age
            bound = self._bounds.setpoint_age
            if facts.state in LATCHED:
                code = ReasonCode.ESTOP if facts.state is RobotState.ESTOP else ReasonCode.FAULT_LATCHED
                finding = Finding(code, message="a latch ends the stream: holding")
                yield RuleResult(finding, Reaction.HOLD, transient=True)
            if age is None or not age <= bound:
                message = "no newer setpoint: holding"
                finding = Finding(ReasonCode.STREAM_STALE, value=age, bound=bound, message=message)
                yield RuleResult(finding, Reaction.HOLD, transient=True)
        if not facts.lease_ok and facts.motion in MOVING and facts.state not in REACTING:
            finding = Finding(ReasonCode.LEASE_LOST, message="the lease lapsed: holding")
            yield RuleResult(finding, Reaction.HOLD, transient=True)

    def goal(self, facts: GuardInput) -> Iterator[RuleResult]:
        """Yield NONFINITE, STEP_LIMIT and OUT_OF_LIMIT.

        A goal is finite, within one step of the last one written, and inside the hard limits.
        """
        if facts.goal is None:
            return
        goal = facts.goal.position
        if not isfinite(float(goal @ goal)):
            joint = int(np.argmin(np.isfinite(goal)))
            finding = Finding(
                ReasonCode.NONFINITE, joint, message="a goal is not finite: holding the last one"
            )
            yield RuleResult(finding, Reaction.HOLD, refuses=True, transient=True)
            return
        away = self._away(facts, goal)
        fits = away <= self._reach
        if every(fits):
            return
        if not every(fits[0]):
            yield self._too_far(facts, int(np.argmin(fits[0])), away[0])
        elif facts.mode is Mode.LIVE:
            yield from self._beyond(facts, goal, away[1])

    def _beyond(self, facts: GuardInput, goal: Floats, away: Floats) -> Iterator[RuleResult]:
        """Check OUT_OF_LIMIT of the goal itself. From beyond the hard limits it may lead inwards."""
        beyond = ~(away <= self._reach[1])
        if facts.previous is not None:
            beyond &= away > np.abs(facts.previous - self._origin[1]) + ROUNDING
        for joint in np.flatnonzero(beyond)[:1].tolist():
            value = float(goal[joint])
            high = value > self._origin[1, joint]
            bound = float((self._limits.hard_upper if high else self._limits.hard_lower)[joint])
            message = "a goal past the hard limit: withheld (an internal error)"
            finding = Finding(ReasonCode.OUT_OF_LIMIT, joint, value=value, bound=bound, message=message)
            yield RuleResult(finding, Reaction.HOLD, refuses=True, transient=True)

    def _too_far(self, facts: GuardInput, joint: int, step: Floats) -> RuleResult:
        """Check STEP_LIMIT. A full port (TX_BACKLOG) sent no goal: the next one is two steps away."""
        full = any(traffic.full for traffic in facts.traffic)
        cause = "the port was full" if full else "an internal error"
        message = f"rad from the last goal written: holding that one ({cause})"
        bound = float(self._limits.velocity[joint]) * facts.period
        finding = Finding(
            ReasonCode.STEP_LIMIT, joint, value=float(step[joint]), bound=bound, message=message
        )
        return RuleResult(finding, Reaction.HOLD, refuses=True, transient=True)


def _late(value: float, bound: float, message: str) -> Finding:
    return Finding(ReasonCode.LOOP_LATE, value=float(value), bound=float(bound), message=message)
