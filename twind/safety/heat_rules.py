"""Temperature of the motors: rule OVERTEMP. Pure.

Readings count five times a second, each once. A joint's temperature is one that three of its last five
readings reach. A reading that no other agrees with is reported, but not used.
"""

from collections.abc import Iterator, Sequence
from math import inf

import numpy as np

from twind.robot.actuator_ratings import ActuatorRatings
from twind.robot.arrays import Bools, Ints, same
from twind.robot.finding import Finding, ReasonCode
from twind.safety.goal_rules import ROUNDING
from twind.safety.guard_types import (
    MOVING,
    NOTHING,
    REACTING,
    GuardInput,
    GuardThresholds,
    Reaction,
    RuleResult,
)

EVERY = 0.2  # s between two counts: more frequent readings bring nothing new, as a case warms slowly


class HeatRules:
    """Rule OVERTEMP.

    Memory per joint: last readings, earlier temperature, and joints that must cool first.
    """

    def __init__(self, ratings: ActuatorRatings, bounds: GuardThresholds) -> None:
        count = len(ratings.warm)
        self._ratings = ratings
        self._bounds = bounds
        need, kept = bounds.votes
        # index, in rising order, of the value that `need` of `kept` readings reach
        self._agreed = kept - need
        self._last = np.full((kept, count), -inf)  # °C; -inf: nothing read yet
        self._read = np.full(count, -inf)  # s, of each last reading
        self._seen = self._read.tobytes()  # the same, as bytes: mostly unchanged
        self._counted = -inf  # s, when readings were counted last
        self._warmth = np.full(count, -inf)  # °C, as they agree
        self._before = np.full(count, -inf)  # °C, `warming_over` ago, ...
        self._then = np.full(count, inf)  # s, ... and the time of it; inf: no agreed reading yet
        self._cooling: Bools = np.zeros(count, np.bool_)
        self._hot: list[int] = []  # joints that are warm, or must cool down

    def judge(self, facts: GuardInput) -> Sequence[RuleResult]:
        """Return OVERTEMP: a warning, then slower, then lowered.

        A hot motor prevents arming until it is cool.
        """
        counted = 0.0 <= facts.now - self._counted < EVERY - ROUNDING
        if not self._hot and (counted or same(facts.health_time, self._seen)):
            return NOTHING
        return tuple(self._found(facts, counted=counted))

    def _found(self, facts: GuardInput, *, counted: bool) -> Iterator[RuleResult]:
        if not counted and not same(facts.health_time, self._seen):
            self._counted = facts.now
            yield from self._refresh(facts)
        for joint in self._hot:
            yield self._warm(facts, joint)

    def _refresh(self, facts: GuardInput) -> Iterator[RuleResult]:
        """Take in new readings."""
        fresh = (facts.health_time != self._read) & (facts.health_time > -inf)
        fresh &= np.isfinite(facts.temperature)
        self._read = facts.health_time.copy()
        self._seen = facts.health_time.tobytes()
        rows = np.flatnonzero(fresh)
        self._last[:-1, rows] = self._last[1:, rows]
        self._last[-1, rows] = facts.temperature[rows]
        self._warmth[rows] = np.sort(self._last[:, rows], axis=0)[self._agreed]
        for joint in rows[self._last[-1, rows] > self._warmth[rows] + self._bounds.spike].tolist():
            yield from self._spike(joint)
        yield from self._warming(facts, rows)
        self._cooling |= self._warmth >= self._ratings.shut
        self._cooling &= self._warmth >= self._ratings.cool
        self._hot = np.flatnonzero((self._warmth >= self._ratings.warm) | self._cooling).tolist()

    def _warm(self, facts: GuardInput, joint: int) -> RuleResult:
        value = float(self._warmth[joint])
        ratings = self._ratings
        cooling = bool(self._cooling[joint])
        if value >= ratings.shut[joint]:
            finding = _heat(joint, value, ratings.shut[joint], "°C: lowered, and not armed before it is cool")
            return RuleResult(
                finding,
                Reaction.SETTLE if facts.torque_held else Reaction.NONE,
                latches=facts.torque_held,
                bars=True,
            )
        if value >= ratings.hot[joint]:
            finding = _heat(joint, value, ratings.hot[joint], "°C: it moves slower")
            moves = facts.motion in MOVING and facts.state not in REACTING
            return RuleResult(
                finding, bars=cooling, pace=self._bounds.hot_pace if moves and facts.torque_held else 1.0
            )
        if value >= ratings.warm[joint]:
            return RuleResult(_heat(joint, value, ratings.warm[joint], "°C: let it rest"), bars=cooling)
        return RuleResult(
            _heat(joint, value, ratings.cool[joint], "°C: not armed before it is cool"), bars=True
        )

    def _spike(self, joint: int) -> Iterator[RuleResult]:
        """Yield a finding for a single high reading; with too few readings nothing is compared."""
        agreed = float(self._warmth[joint])
        value = float(self._last[-1, joint])
        if agreed > -inf:
            message = f"°C read, while the other readings agree on {agreed:g}: not used"
            yield RuleResult(_heat(joint, value, agreed + self._bounds.spike, message))

    def _warming(self, facts: GuardInput, rows: Ints) -> Iterator[RuleResult]:
        """Yield a finding for each joint that warms too fast, since `warming_over` ago."""
        bounds = self._bounds
        for joint in rows[self._warmth[rows] > -inf].tolist():
            now = float(facts.health_time[joint])
            warmth = float(self._warmth[joint])
            span = now - self._then[joint]
            if -inf < span < bounds.warming_over - ROUNDING:
                continue
            slope = (warmth - self._before[joint]) / span if span > 0.0 else 0.0
            self._then[joint] = now
            self._before[joint] = warmth
            if slope > bounds.warming + ROUNDING:
                yield RuleResult(_heat(joint, float(slope), bounds.warming, "°C/s warmer: what loads it?"))


def _heat(joint: int, value: float, bound: float, message: str) -> Finding:
    return Finding(ReasonCode.OVERTEMP, joint, value=value, bound=float(bound), message=message)
