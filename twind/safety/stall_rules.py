"""Rules on time: TIME_GAP between ticks, and the length of a hold of a free-standing robot. Pure."""

from collections.abc import Sequence
from dataclasses import replace
from math import inf

from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Motion
from twind.safety.guard_types import NOTHING, GuardInput, GuardThresholds, Reaction, RuleResult, hold
from twind.safety.state_machine import LATCHED


class TimeGapRules:
    """Rule TIME_GAP; memory: the time of the last tick, and how long the machine has slept.

    The clock stands still while the machine sleeps.
    """

    def __init__(self, bounds: GuardThresholds) -> None:
        self._bounds = bounds
        self._last: float | None = None  # s
        self._suspended = 0.0  # s

    def judge(self, facts: GuardInput) -> Sequence[RuleResult]:
        """Return TIME_GAP after a gap longer than the servos' watchdogs, which may have stopped them.

        The last goal is repeated, and the fault makes an operator disarm, which sets the goals to the present
        positions.
        """
        last = self._last
        asleep = facts.suspended - self._suspended
        self._last = facts.now
        self._suspended = facts.suspended
        if last is None or not facts.torque_ours:
            return NOTHING
        gap = facts.now - last - facts.period
        bound = self._bounds.gap
        if gap + asleep < bound:
            return NOTHING
        what = "s that the machine slept" if asleep >= bound else "s without a tick"
        message = f"{what}: the servos have stopped by themselves: disarm, reset, arm"
        finding = Finding(ReasonCode.TIME_GAP, value=gap + asleep, bound=bound, message=message)
        stop = hold(facts)
        refuses = facts.goal is not None and stop is Reaction.HOLD
        return (RuleResult(finding, stop, latches=True, refuses=refuses),)


class HoldRules:
    """Limit of a hold on a free-standing robot; memory: its start and its cause. Other robots hold on."""

    def __init__(self, free: bool, bounds: GuardThresholds) -> None:
        self._free = free
        self._bounds = bounds
        self._since = inf
        self._why = Finding(ReasonCode.INTERNAL)
        self._ended = False  # the hold ended a motion

    def judge(self, facts: GuardInput, results: Sequence[RuleResult]) -> Sequence[RuleResult]:
        """Lower a robot after a hold that a rule requested and that did not end.

        Where the robot held anyway, and nothing is latched, the hold ends with its cause.
        """
        if not self._free:
            return NOTHING
        if not facts.torque_held or not facts.torque_settled:
            self._since = inf
            self._ended = False
            return NOTHING
        holds = next((one.finding for one in results if one.reaction is Reaction.HOLD), None)
        rests = facts.motion is Motion.HOLDING
        if holds is None and not (rests and (self._ended or facts.state in LATCHED)):
            self._since = inf
            self._ended = False
        elif holds is not None:
            self._ended |= not rests
            if self._since == inf:
                self._since = facts.now
                self._why = holds
        most = self._bounds.hold_most
        if not facts.now - self._since >= most:
            return NOTHING
        message = f"held for {most:g} s without support: lowered ({self._why.message})"
        finding = replace(self._why, value=facts.now - self._since, bound=most, message=message)
        return (RuleResult(finding, Reaction.SETTLE, latches=True),)
