"""Readings of the joints: rules STATE_STALE, SENSE_JUMP and OUT_OF_LIMIT. Pure."""

from collections.abc import Iterator, Sequence

import numpy as np

from twind.robot.arrays import Floats, every, some
from twind.robot.finding import Finding, ReasonCode
from twind.robot.joint_limits import JointLimits
from twind.safety.goal_rules import ROUNDING
from twind.safety.guard_types import MOVING, NOTHING, GuardInput, GuardThresholds, Reaction, RuleResult, hold


class ReadingRules:
    """Rules without memory: each tick by itself. The memory of SENSE_JUMP is in `PlausibilityFilter`."""

    def __init__(self, limits: JointLimits, bounds: GuardThresholds, free: bool) -> None:
        """`free`: the robot stands freely, without support."""
        self._limits = limits
        self._bounds = bounds
        self._free = free
        self._hard_lower = limits.hard_lower - bounds.beyond_hard
        self._hard_upper = limits.hard_upper + bounds.beyond_hard

    def judge(self, facts: GuardInput) -> Sequence[RuleResult]:
        """Return STATE_STALE, SENSE_JUMP and OUT_OF_LIMIT."""
        measured = facts.measured
        if measured is not None and not some(facts.jumps):
            position = measured.position
            fresh = every(measured.age <= self._bounds.stale_warn - (facts.now - measured.time))
            limits = self._limits
            if fresh and every((position >= limits.lower) & (position <= limits.upper)):
                return NOTHING
        return tuple(self._found(facts))

    def _found(self, facts: GuardInput) -> Iterator[RuleResult]:
        if some(facts.jumps):
            yield from self._jumps(facts)
        measured = facts.measured
        if measured is None:
            if facts.torque_held:
                yield RuleResult(
                    Finding(ReasonCode.STATE_STALE, message="no reading at all: holding"), hold(facts)
                )
            return
        yield from self._stale(facts, measured.age + (facts.now - measured.time))
        yield from self._beyond(facts, measured.position)
        yield from self._outward(facts, measured.position)

    def _jumps(self, facts: GuardInput) -> Iterator[RuleResult]:
        """Yield SENSE_JUMP: an impossible reading is reported; several in a row hold the robot."""
        most = self._bounds.jumps
        for joint in np.flatnonzero(facts.jumps).tolist():
            many = not facts.jumps[joint] < most
            text = f"rad from where it was just before, {facts.jumps[joint]} in a row: "
            text += "check its horn, gear, cable and calibration" if many else "more than its motor can do"
            bound = float(most if many else 1)
            finding = Finding(
                ReasonCode.SENSE_JUMP, joint, value=float(facts.leaps[joint]), bound=bound, message=text
            )
            yield RuleResult(finding, hold(facts) if many and facts.torque_held else Reaction.NONE)

    def _stale(self, facts: GuardInput, age: Floats) -> Iterator[RuleResult]:
        """Yield STATE_STALE.

        A silent joint may be limp: the others hold, but a free-standing robot is lowered.
        """
        bounds = self._bounds
        for joint in np.flatnonzero(~(age <= bounds.stale_warn)).tolist():
            value = float(age[joint])
            bound = bounds.stale_warn
            reaction = Reaction.NONE
            gone = not value <= bounds.stale_fault
            if gone:
                bound = bounds.stale_fault
                reaction = Reaction.SETTLE if self._free else hold(facts)
            elif not value <= bounds.stale_hold:
                bound = bounds.stale_hold
                reaction = hold(facts)
            finding = Finding(
                ReasonCode.STATE_STALE, joint, value=value, bound=bound, message="s since its last reading"
            )
            if facts.torque_held:
                yield RuleResult(finding, reaction, latches=gone)
            else:
                yield RuleResult(finding)

    def _beyond(self, facts: GuardInput, position: Floats) -> Iterator[RuleResult]:
        """Yield OUT_OF_LIMIT past the hard limit.

        A joint that was never read (NaN) is reported by STATE_STALE.
        """
        low = position < self._hard_lower
        high = position > self._hard_upper
        for joint in np.flatnonzero(low | high).tolist():
            bound = float((self._hard_lower if low[joint] else self._hard_upper)[joint])
            message = "past the hard limit: move it inside by hand, check its calibration"
            finding = Finding(
                ReasonCode.OUT_OF_LIMIT, joint, value=float(position[joint]), bound=bound, message=message
            )
            if facts.torque_held and not facts.is_limp(joint):
                yield RuleResult(finding, hold(facts), latches=True)
            else:
                yield RuleResult(finding)

    def _outward(self, facts: GuardInput, position: Floats) -> Iterator[RuleResult]:
        """Yield OUT_OF_LIMIT for a motion past a limit that leads outwards.

        A hold or a stop is never refused.
        """
        if facts.goal is None or facts.previous is None or facts.motion not in MOVING:
            return
        goal = facts.goal.position
        previous = facts.previous
        limits = self._limits
        above = (position > limits.upper) & (goal > limits.upper) & (goal > previous + ROUNDING)
        below = (position < limits.lower) & (goal < limits.lower) & (goal < previous - ROUNDING)
        outward = above | below if facts.limp is None else (above | below) & ~facts.limp
        for joint in np.flatnonzero(outward).tolist():
            bound = float((limits.upper if above[joint] else limits.lower)[joint])
            message = "past its limit it may only move inwards: holding the last goal"
            finding = Finding(
                ReasonCode.OUT_OF_LIMIT, joint, value=float(goal[joint]), bound=bound, message=message
            )
            yield RuleResult(finding, Reaction.HOLD, refuses=True, transient=True)
