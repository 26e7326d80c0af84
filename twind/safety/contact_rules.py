"""Rules CONTACT and CONTACT_HOLD: torque from outside that the model of the robot does not explain. Pure."""

from collections.abc import Sequence
from math import inf

import numpy as np

from twind.robot.arrays import Floats, every, some
from twind.robot.finding import Finding, ReasonCode
from twind.safety.guard_types import NOTHING, GuardInput, Reaction, RuleResult, detection_lost, hold

BEGIN = 5.0  # standard deviations at which a contact begins ...
END = 2.5  # ... and below which it ends
TICKS = 2  # in a row that a contact takes to begin
LOST = 0.2  # s without an estimate, from which on it is reported


BLIND = detection_lost(
    "no estimate of torque from outside, so that no contact holds the robot: a joint is silent or its torque "
    "unknown"
)


class ContactRules:
    """Memory: the joints in contact, and for how many ticks each has been beyond its threshold."""

    def __init__(self, hold_nm: Floats, limbs: Sequence[str]) -> None:
        """`hold_nm` (n,): N·m of CONTACT_HOLD, inf: the joint holds nothing; `limbs` (n): for people."""
        self._bound = hold_nm
        self._limbs = limbs
        self._beyond = np.zeros(len(hold_nm), np.int64)
        self._active = False  # a joint was beyond its threshold in the last tick
        self._bounded = some(np.isfinite(hold_nm))
        self._stops: list[Finding] = []  # CONTACT_HOLD of the last estimate
        self._estimated = -inf  # s, when there was one, or the robot without torque
        self.touched = np.zeros(len(hold_nm), np.bool_)  # (n,), the joints in contact

    def judge(self, facts: GuardInput) -> Sequence[RuleResult]:
        """Return CONTACT of each joint while it lasts, and CONTACT_HOLD while the robot must stand still.

        Without an estimate a hold lasts, and is reported as blind after `LOST`.
        """
        external = facts.external
        if external is None:
            return self._blind(facts)
        self._estimated = facts.now
        size = np.abs(external.torque)
        deviation = external.deviation
        if not self._active and every(size <= np.minimum(BEGIN * deviation, self._bound + deviation)):
            self._stops = []
            return NOTHING
        over = size > np.where(self.touched, END, BEGIN) * deviation
        stopping = (size - deviation > self._bound) & facts.torque_held
        self._active = some(over)
        self._beyond = np.where(over, self._beyond + 1, 0)
        self.touched = over & (self._beyond >= TICKS)
        torque = external.torque
        self._stops = [self._stop(joint, float(torque[joint])) for joint in np.flatnonzero(stopping).tolist()]
        return self._holds(facts) + [
            self._touch(joint, float(torque[joint])) for joint in np.flatnonzero(self.touched).tolist()
        ]

    def _blind(self, facts: GuardInput) -> Sequence[RuleResult]:
        self.touched[:] = False
        self._beyond[:] = 0
        self._active = False
        if not facts.torque_held or not self._bounded:
            self._estimated = facts.now
            self._stops = []
            return NOTHING
        if facts.now - self._estimated <= LOST:
            return self._holds(facts)
        return [*self._holds(facts), BLIND]

    def _holds(self, facts: GuardInput) -> list[RuleResult]:
        return [RuleResult(finding, hold(facts)) for finding in self._stops]

    def _stop(self, joint: int, torque: float) -> Finding:
        message = f"N·m from outside on {self._limbs[joint]}: holding until it is released"
        bound = float(self._bound[joint])
        return Finding(ReasonCode.CONTACT_HOLD, joint, value=torque, bound=bound, message=message)

    def _touch(self, joint: int, torque: float) -> RuleResult:
        message = f"N·m from outside on {self._limbs[joint]}"
        return RuleResult(Finding(ReasonCode.CONTACT, joint, value=torque, message=message), Reaction.NONE)
