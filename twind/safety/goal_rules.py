"""What may move the robot, and what may be written: rules R01–R04, R21, W5 and NaN. Pure."""

from collections.abc import Iterator
from math import isfinite

import numpy as np

from twind.robot.arrays import Floats, every
from twind.robot.finding import Code, Finding
from twind.robot.limits import Limits
from twind.robot.modes import Mode, Motion, State
from twind.safety.facts import MOVING, REACTING, Facts, Reaction, Said, Thresholds, hold
from twind.safety.states import LATCHED

UNWRITABLE = (State.IDENTIFYING, State.CONNECTED, State.CALIBRATING, State.INHIBITED)  # W5
ROUNDING = 1e-9  # rad, of a goal that moves at exactly the velocity limit; of ticks and times too


class GoalRules:
    """Without memory: each tick by itself."""

    def __init__(self, limits: Limits, bounds: Thresholds) -> None:
        self._limits, self._bounds = limits, bounds
        self._period, self._most = 0.0, 0.0 * limits.velocity  # s, and rad in one such tick

    def timing(self, facts: Facts) -> Iterator[Said]:
        """R02: late ticks are told, too many missed ones hold. The executor re-times by itself."""
        bounds, missed = self._bounds, facts.missed_in_a_row
        most = max(float(bounds.missed_hold), bounds.missed_for / facts.period)
        if missed >= most - ROUNDING:
            yield Said(_late(missed, most, "ticks missed in a row: holding"), hold(facts))
        elif missed >= bounds.missed_warn:
            yield Said(_late(missed, bounds.missed_warn, "ticks missed in a row"))
        elif not facts.lateness <= bounds.late:
            yield Said(_late(facts.lateness, bounds.late, "s that the tick began late"))

    def authority(self, facts: Facts) -> Iterator[Said]:
        """R01, R03, R04 and W5: who moves the robot, and in which state."""
        if facts.goal is not None and facts.mode is Mode.LIVE and facts.state in UNWRITABLE:
            message = f"a goal while {facts.state.value}: nothing may be written"
            yield Said(Finding(Code.INTERNAL, message=message), Reaction.INHIBIT, refuses=True)
        if facts.motion is Motion.STREAMING:
            age, bound = facts.setpoint_age, self._bounds.setpoint_age
            if facts.state in LATCHED:
                code = Code.ESTOP if facts.state is State.ESTOP else Code.FAULT_LATCHED
                yield Said(Finding(code, message="a latch ends the stream: holding"), Reaction.HOLD)
            if age is None or not age <= bound:
                message = "no newer setpoint: holding"
                yield Said(Finding(Code.STREAM_STALE, value=age, bound=bound, message=message), Reaction.HOLD)
        if not facts.lease_ok and facts.motion in MOVING and facts.state not in REACTING:
            yield Said(Finding(Code.LEASE_LOST, message="the lease lapsed: holding"), Reaction.HOLD)

    def goal(self, facts: Facts) -> Iterator[Said]:
        """R21 and NaN: what is written is finite, and within one step of what was written last."""
        if facts.goal is None:
            return
        goal = facts.goal.position
        if not isfinite(float(goal @ goal)):
            joint = int(np.argmin(np.isfinite(goal)))
            finding = Finding(Code.NONFINITE, joint, message="a goal that is no number: holding the last one")
            yield Said(finding, Reaction.HOLD, refuses=True)
        elif facts.previous is not None:
            if facts.period != self._period:
                self._period, self._most = facts.period, self._limits.velocity * facts.period + ROUNDING
            step = np.abs(goal - facts.previous)
            fits = step <= self._most
            if not every(fits):
                yield self._too_far(facts, int(np.argmin(fits)), step)

    def _too_far(self, facts: Facts, joint: int, step: Floats) -> Said:
        """R21. A goal that the port had no room for (R23) never left: then the next one is two steps away."""
        full = any(traffic.full for traffic in facts.traffic)
        cause = "the port was full" if full else "a bug of ours"
        message = f"rad from the last goal that left: holding that one ({cause})"
        bound = float(self._limits.velocity[joint]) * facts.period
        finding = Finding(Code.STEP_LIMIT, joint, value=float(step[joint]), bound=bound, message=message)
        return Said(finding, Reaction.HOLD, refuses=True)


def _late(value: float, bound: float, message: str) -> Finding:
    return Finding(Code.LOOP_LATE, value=float(value), bound=float(bound), message=message)
