"""Rules on motion sources and written goals: ESTOP to STREAM_STALE, STEP_LIMIT, finite numbers. Pure."""

from collections.abc import Iterator, Sequence
from math import isfinite

import numpy as np

from twind.robot.arrays import Floats, every
from twind.robot.finding import Finding, ReasonCode
from twind.robot.joint_limits import JointLimits
from twind.robot.modes import Mode, Motion, RobotState
from twind.robot.trajectory import Reference
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
        # s; rad in one such tick
        self._period = 0.0
        self._most = 0.0 * limits.velocity

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
        previous = facts.previous
        if goal is None or previous is None:
            return goal is None
        step = self._step(facts, goal, previous)
        return every(step <= self._most)

    def _step(self, facts: GuardInput, goal: Reference, previous: Floats) -> Floats:
        """Return the distance (n,), rad, of the goal from the last one that was sent."""
        if facts.period != self._period:
            self._period = facts.period
            # A larger step would drive the servo faster than the joint's limit (docs/proof.md).
            self._most = self._limits.velocity * facts.period + ROUNDING
        step: Floats = np.abs(goal.position - previous)
        return step

    def timing(self, facts: GuardInput) -> Iterator[RuleResult]:
        """Yield LOOP_LATE: late ticks are reported, too many missed ones hold.

        The executor re-times by itself.
        """
        bounds = self._bounds
        missed = facts.missed_in_a_row
        most = max(float(bounds.missed_hold), bounds.missed_for / facts.period)
        if missed >= most - ROUNDING:
            yield RuleResult(_late(missed, most, "ticks missed in a row: holding"), hold(facts))
        elif missed >= bounds.missed_warn:
            yield RuleResult(_late(missed, bounds.missed_warn, "ticks missed in a row"))
        elif not facts.lateness <= bounds.late:
            yield RuleResult(_late(facts.lateness, bounds.late, "s that the tick began late"))

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
                yield RuleResult(Finding(code, message="a latch ends the stream: holding"), Reaction.HOLD)
            if age is None or not age <= bound:
                message = "no newer setpoint: holding"
                yield RuleResult(
                    Finding(ReasonCode.STREAM_STALE, value=age, bound=bound, message=message), Reaction.HOLD
                )
        if not facts.lease_ok and facts.motion in MOVING and facts.state not in REACTING:
            yield RuleResult(
                Finding(ReasonCode.LEASE_LOST, message="the lease lapsed: holding"), Reaction.HOLD
            )

    def goal(self, facts: GuardInput) -> Iterator[RuleResult]:
        """Yield STEP_LIMIT and NONFINITE: a goal is finite, and within one step of the last one written."""
        if facts.goal is None:
            return
        goal = facts.goal.position
        if not isfinite(float(goal @ goal)):
            joint = int(np.argmin(np.isfinite(goal)))
            finding = Finding(
                ReasonCode.NONFINITE, joint, message="a goal is not finite: holding the last one"
            )
            yield RuleResult(finding, Reaction.HOLD, refuses=True)
        elif facts.previous is not None:
            step = self._step(facts, facts.goal, facts.previous)
            fits = step <= self._most
            if not every(fits):
                yield self._too_far(facts, int(np.argmin(fits)), step)

    def _too_far(self, facts: GuardInput, joint: int, step: Floats) -> RuleResult:
        """Check STEP_LIMIT. A full port (TX_BACKLOG) sent no goal: the next one is two steps away."""
        full = any(traffic.full for traffic in facts.traffic)
        cause = "the port was full" if full else "an internal error"
        message = f"rad from the last goal written: holding that one ({cause})"
        bound = float(self._limits.velocity[joint]) * facts.period
        finding = Finding(
            ReasonCode.STEP_LIMIT, joint, value=float(step[joint]), bound=bound, message=message
        )
        return RuleResult(finding, Reaction.HOLD, refuses=True)


def _late(value: float, bound: float, message: str) -> Finding:
    return Finding(ReasonCode.LOOP_LATE, value=float(value), bound=float(bound), message=message)
