"""Load and supply of the motors: rules OVERCURRENT and VOLTAGE. Pure.

OVERCURRENT counts shares of the current limit. The square of the load heats a motor: beyond the square of
`ActuatorRatings.continuous` it is summed up over time (I²t), below it the motor recovers. The rule stops a
motion before the servo shuts itself down for overload.
"""

from collections.abc import Iterator, Sequence
from math import inf, isfinite

import numpy as np

from twind.robot.actuator_ratings import ActuatorRatings
from twind.robot.arrays import Bools, Floats, every, same, some
from twind.robot.finding import Finding, ReasonCode
from twind.safety.goal_rules import ROUNDING
from twind.safety.guard_types import (
    NOTHING,
    GuardInput,
    GuardThresholds,
    Reaction,
    RuleResult,
    hold,
    hold_here,
)

LONGEST = 0.5  # s: the longest tick that is summed up: a longer gap has no measured load


class CurrentRules:
    """Rule OVERCURRENT; memory per joint: start of a high load, and the I²t sum."""

    def __init__(self, ratings: ActuatorRatings, bounds: GuardThresholds) -> None:
        count = len(ratings.continuous)
        self._bounds = bounds
        self._bearable = np.square(ratings.continuous)
        self._tired = np.zeros(count)  # s at the whole current limit, beyond the continuous load
        self._above = np.full((2, count), inf)  # s, since when the load is above each of its two bounds
        self._high = False  # a joint is above a bound
        self._last = inf  # s, of the last check

    def judge(self, facts: GuardInput) -> Sequence[RuleResult]:
        """Return OVERCURRENT, where the load is known.

        Motors recover at rest; a tired one prevents arming.
        """
        span = facts.now - self._last
        if facts.load is None or (not self._high and 0.0 <= span < self._bounds.look - ROUNDING):
            return NOTHING
        return tuple(self._found(facts, facts.load, span))

    def _found(self, facts: GuardInput, load: Floats, span: float) -> Iterator[RuleResult]:
        bounds = self._bounds
        self._last = facts.now
        if not isfinite(load.dot(load)):
            load = np.where(np.isfinite(load), load, 0.0)  # unknown for this joint, so not judged
        self._tired += (load * load - self._bearable) * min(max(span, 0.0), LONGEST)
        np.maximum(self._tired, 0.0, out=self._tired)
        if every(load < bounds.load_warn) and every(self._tired < bounds.tired_warn):
            if self._high:
                self._above[:] = inf
                self._high = False
            return
        self._high = True
        if facts.torque_held:
            yield from self._loaded(facts, load)
            yield from self._wearied(facts, load)
        else:
            self._above[:] = inf  # earlier load does not count after a new arming
            yield from self._unrested()

    def _loaded(self, facts: GuardInput, load: Floats) -> Iterator[RuleResult]:
        """Yield a load near the current limit for too long: reported, held, then damped."""
        bounds = self._bounds
        for above, least in zip(self._above, (bounds.load_warn, bounds.load_hold), strict=True):
            above[:] = np.where(load >= least, np.minimum(above, facts.now), inf)
        warned, high = facts.now - self._above + ROUNDING
        for joint in np.flatnonzero(
            (warned >= bounds.load_warn_for) | (high >= bounds.load_hold_for)
        ).tolist():
            value = float(load[joint])
            long = float(high[joint])
            if not long >= bounds.load_hold_for:
                yield RuleResult(
                    _load(joint, value, bounds.load_warn, "of its current limit: what loads it?")
                )
            elif not long >= 2.0 * bounds.load_hold_for:
                finding = _load(joint, value, bounds.load_hold, "of its current limit: held where it is")
                yield RuleResult(finding, hold_here(facts), latches=True, here=True)
            else:
                finding = _load(
                    joint, value, bounds.load_hold, "of its current limit still: soft from now on"
                )
                yield RuleResult(finding, Reaction.DAMP, latches=True, here=True)

    def _wearied(self, facts: GuardInput, load: Floats) -> Iterator[RuleResult]:
        """Yield I²t: reported, held, then lowered.

        A joint that still pushes is held at its measured position.
        """
        bounds = self._bounds
        for joint in np.flatnonzero(self._tired >= bounds.tired_warn).tolist():
            value = float(self._tired[joint])
            if value >= bounds.tired_settle:
                finding = _load(joint, value, bounds.tired_settle, "s of its current limit too much: lowered")
                yield RuleResult(finding, Reaction.SETTLE, latches=True)
            elif value >= bounds.tired_hold:
                finding = _load(joint, value, bounds.tired_hold, "s of its current limit too much: holding")
                pushes = bool(load[joint] ** 2 > self._bearable[joint])
                yield RuleResult(
                    finding, hold_here(facts) if pushes else hold(facts), latches=True, here=pushes
                )
            else:
                finding = _load(joint, value, bounds.tired_warn, "s of its current limit beyond its own")
                yield RuleResult(finding)

    def _unrested(self) -> Iterator[RuleResult]:
        """Yield I²t without torque: armed now, the robot would be held at once."""
        bound = self._bounds.tired_hold
        for joint in np.flatnonzero(self._tired >= bound).tolist():
            value = float(self._tired[joint])
            finding = _load(joint, value, bound, "s of its current limit too much: not armed before it rests")
            yield RuleResult(finding, bars=True)


def _load(joint: int, value: float, bound: float, message: str) -> Finding:
    return Finding(ReasonCode.OVERCURRENT, joint, value=value, bound=bound, message=message)


class VoltageRules:
    """Rule VOLTAGE; memory per joint: the start of a low supply, by each bound."""

    def __init__(self, ratings: ActuatorRatings, bounds: GuardThresholds) -> None:
        self._bounds = bounds
        self._high = ratings.high_warn + ROUNDING
        self._low = np.array([ratings.low_warn, ratings.low_settle, ratings.low_fault]) + ROUNDING
        self._fine = self._low.max(axis=0)  # V: above all three, as far as they are known
        # Without a bound nothing is judged: some actuators never report their supply.
        self._has_bound = self._low > -inf
        self._unjudged = (self._fine == -inf) & (self._high == inf)
        self._since = np.full(self._low.shape, inf)  # s, of the first low reading
        self._read = np.full(self._low.shape[1], -inf)  # s, of each last reading
        self._seen = b""  # the same, as bytes: mostly unchanged
        self._suspect = False  # a supply is low
        self._held = inf  # s, since when torque of this daemon holds the robot; inf: it does not
        self._results: list[RuleResult] = []
        self._checked_at = -inf  # s, when the age of the readings was checked

    def judge(self, facts: GuardInput) -> Sequence[RuleResult]:
        """Return VOLTAGE: the lowest and the highest supply of a robot under torque.

        One report for all joints.
        """
        if not facts.torque_held and self._held == inf:
            return NOTHING
        checked = 0.0 <= facts.now - self._checked_at < self._bounds.look - ROUNDING
        if facts.torque_held and checked and not self._results and same(facts.health_time, self._seen):
            return NOTHING
        return tuple(self._found(facts))

    def _found(self, facts: GuardInput) -> Iterator[RuleResult]:
        if not facts.torque_held:
            self._since[:] = inf
            self._read[:] = -inf
            self._seen = b""
            self._results = []
            self._held = inf
            self._suspect = False
            return
        self._held = min(self._held, facts.now)
        if not same(facts.health_time, self._seen):
            self._results = list(self._refresh(facts))
        yield from self._results
        unread = self._bounds.unread
        old = facts.now - self._held > unread and not every(facts.now - facts.health_time <= unread)
        self._checked_at = -inf if old else facts.now
        if old:
            yield self._unread(facts)

    def _refresh(self, facts: GuardInput) -> Iterator[RuleResult]:
        """Take in new readings. Low means two readings `volt_for` apart, of one servo or of two."""
        fresh = facts.health_time != self._read
        self._read = facts.health_time.copy()
        self._seen = facts.health_time.tobytes()
        volts = facts.voltage
        fine = not self._suspect
        if fine and every(self._unjudged | ((volts > self._fine) & (volts <= self._high))):
            return
        read = self._read > -inf
        high = read & (volts > self._high)
        if some(high):
            joint = int(np.argmax(np.where(high, volts, -inf)))
            yield RuleResult(
                _volts(facts, joint, float(self._high[joint]) - ROUNDING, "is more than it bears")
            )
        # NaN is low too. An old reading does not confirm a servo that reads low now.
        old = facts.now - facts.health_time > self._bounds.unread + ROUNDING
        low = read & ~old & self._has_bound & ~(volts > self._low)
        self._suspect = some(low)
        begun = np.minimum(self._since, facts.health_time)
        self._since = np.where(low, np.where(fresh, begun, self._since), inf)
        if self._suspect:
            yield from self._lowest(facts, low)

    def _lowest(self, facts: GuardInput, low: Bools) -> Iterator[RuleResult]:
        """Yield the hardest bound that is violated, named for the servo with the lowest supply."""
        answers = (
            ("is low: charge it, or check supply and cables", Reaction.NONE, False),
            ("is too low to move: lowered", Reaction.SETTLE, True),
            ("is too low to hold: soft, then off", Reaction.DAMP, True),
        )
        for level in (2, 1, 0):
            since = self._since[level]
            newest = np.where(low[level], facts.health_time, -inf)
            if not newest.max() - since.min() >= self._bounds.volt_for - ROUNDING:
                continue
            joint = int(np.argmin(np.where(low[level], np.nan_to_num(facts.voltage, nan=-1.0), inf)))
            message, reaction, latches = answers[level]
            bound = float(self._low[level, joint]) - ROUNDING
            yield RuleResult(_volts(facts, joint, bound, message), reaction, latches=latches)
            return

    def _unread(self, facts: GuardInput) -> RuleResult:
        age = facts.now - facts.health_time
        joint = int(np.argmax(age))
        value = float(age[joint])
        bound = self._bounds.unread
        message = "s since its temperature and supply were read"
        finding = Finding(ReasonCode.VOLTAGE, joint, value=value, bound=bound, message=message)
        return RuleResult(finding)


def _volts(facts: GuardInput, joint: int, bound: float, what: str) -> Finding:
    value = float(facts.voltage[joint])
    return Finding(ReasonCode.VOLTAGE, joint, value=value, bound=bound, message=f"V, the supply {what}")
