"""The LOOKAHEAD_COLLISION rule on the clearance just ahead of the commanded path. Pure: the twin measures it.

Between `warn` and `block` a motion slows down in proportion; at `block` it is held.
"""

from collections.abc import Sequence

from twind.robot.finding import Finding, ReasonCode
from twind.safety.guard_types import (
    MOVING,
    NOTHING,
    REACTING,
    ClearanceAhead,
    GuardInput,
    GuardThresholds,
    Reaction,
    RuleResult,
)


class LookaheadCollisionRules:
    """Rule LOOKAHEAD_COLLISION, without memory."""

    def __init__(self, bounds: GuardThresholds) -> None:
        self._bounds = bounds

    def judge(self, facts: GuardInput) -> Sequence[RuleResult]:
        """Return LOOKAHEAD_COLLISION for a motion only, never for a hold, a stop or the way to the rest pose.

        A pair that comes no nearer than it is already is not in the outlook, so a motion may lead out of a
        bad place.
        """
        outlook = facts.outlook
        if outlook is None or outlook.clearance > outlook.warn:
            return NOTHING
        if facts.motion not in MOVING or facts.state in REACTING:
            return NOTHING
        return (reaction_to(outlook, self._bounds.least_pace),)


def reaction_to(outlook: ClearanceAhead, least_pace: float) -> RuleResult:
    """Return the hold or the pace, at least `least_pace`, of a motion whose clearance is below `warn`."""
    if not outlook.clearance > outlook.block:  # NaN too
        return RuleResult(_near(outlook, outlook.block, "holding"), Reaction.HOLD, transient=True)
    room = (outlook.clearance - outlook.block) / (outlook.warn - outlook.block)
    return RuleResult(_near(outlook, outlook.warn, "slower"), pace=max(least_pace, room))


def _near(outlook: ClearanceAhead, bound: float, what: str) -> Finding:
    first, second = outlook.pair
    message = f"m between {first} and {second} in {outlook.ahead:.2f} s on this path: {what}"
    return Finding(
        ReasonCode.LOOKAHEAD_COLLISION,
        time=outlook.ahead,
        value=outlook.clearance,
        bound=bound,
        message=message,
    )
