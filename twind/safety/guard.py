"""The per-tick gate: what may be written now, and how to react to what was read (docs/reason-codes.md).

Pure: facts in, a judgement out. A goal may only be turned into a hold; stop, hold and torque-off are never
refused. The rules stand by subject in the modules `..._rules`; here they are collected, and said. Memory is
counters and hysteresis alone: what was bad, what was said when.
"""

from collections.abc import Mapping, Sequence
from math import inf

from twind.robot.actuator_ratings import ActuatorRatings
from twind.robot.finding import Finding
from twind.robot.joint_limits import JointLimits
from twind.robot.modes import RobotState
from twind.robot.transmission import MappedTransmission
from twind.safety.bus_rules import BusRules
from twind.safety.can_line_rules import LineRules
from twind.safety.clearance_rules import ahead
from twind.safety.device_rules import DeviceRules
from twind.safety.goal_rules import UNWRITABLE, GoalRules
from twind.safety.guard_types import (
    MOVING,
    REACTING,
    BusTraffic,
    GuardDecision,
    GuardInput,
    GuardThresholds,
    Key,
    Reaction,
    RuleResult,
)
from twind.safety.heat_rules import HeatRules
from twind.safety.power_rules import CurrentRules, VoltageRules
from twind.safety.reading_rules import ReadingRules
from twind.safety.stall_rules import HoldRules, TimeGapRules
from twind.safety.state_machine import LATCHED
from twind.safety.tracking_rules import TrackingRules

__all__ = [
    "FINE",
    "MOVING",
    "REACTING",
    "UNWRITABLE",
    "BusTraffic",
    "Guard",
    "GuardDecision",
    "GuardInput",
    "GuardThresholds",
    "Reaction",
]

FINE = GuardDecision()
STOPPED = (*LATCHED, RobotState.INHIBITED)  # what latches is in force already: told like anything else


class Guard:
    """Judges every tick, and remembers what was said when."""

    def __init__(
        self,
        limits: JointLimits,
        thresholds: GuardThresholds | None = None,
        *,
        buses: Sequence[str] = (),
        can: Mapping[str, Sequence[int]] | None = None,
        support: str = "free",
        ratings: ActuatorRatings | None = None,
        linked: Sequence[MappedTransmission] = (),
    ) -> None:
        """`buses`: their names, in the order of `GuardInput.traffic`. `can`: the joints of each of them that
        is a CAN bus. `support`: of the robot file. `ratings`: what the motors bear; without them nobody's
        supply, heat or load has a bound. `linked`: whose actuators turn joints together."""
        self._bounds = bounds = thresholds if thresholds is not None else GuardThresholds()
        rated = ratings if ratings is not None else ActuatorRatings.unknown(len(limits.lower))
        free = support not in ("fixed", "gantry")
        self._gaps = TimeGapRules(bounds)
        self._holds = HoldRules(free, bounds)
        self._goals = GoalRules(limits, bounds)
        self._readings = ReadingRules(limits, bounds, free)
        lines = can if can is not None else {}
        self._buses = BusRules(buses, bounds)
        self._lines = LineRules(buses, lines, free, bounds)
        on_can = frozenset(joint for joints in lines.values() for joint in joints)
        self._devices = DeviceRules(rated.leg, free, bounds, on_can)
        self._tracking = TrackingRules(limits, bounds, linked)
        self._heat = HeatRules(rated, bounds)
        self._currents = CurrentRules(rated, bounds)
        self._volts = VoltageRules(rated, bounds)
        self._free = free
        self._linked = linked
        self._present: set[Key] = set()  # said of the last tick, and told then or before
        self._told: dict[Key, float] = {}  # s, when each was last told
        self.bars: tuple[Finding, ...] = ()  # of the last tick: why nobody may arm now

    @property
    def bounds(self) -> GuardThresholds:
        """The thresholds of all rules."""
        return self._bounds

    def limit(self, limits: JointLimits) -> None:
        """From now on these limits count, of a robot that is at rest. What was said, and what motors and
        buses have been through, is remembered."""
        self._goals = GoalRules(limits, self._bounds)
        self._readings = ReadingRules(limits, self._bounds, self._free)
        self._tracking = TrackingRules(limits, self._bounds, self._linked)

    def judge(self, facts: GuardInput) -> GuardDecision:
        """The reaction to this tick's facts, and what to tell. Never raises for bad numbers."""
        said = [*self._gaps.judge(facts), *self._goals.timing(facts), *self._goals.authority(facts)]
        said += [*self._goals.goal(facts), *ahead(facts, self._bounds), *self._readings.judge(facts)]
        said += [*self._tracking.judge(facts), *self._buses.judge(facts), *self._lines.judge(facts)]
        said += [*self._devices.judge(facts), *self._currents.judge(facts)]
        said += [*self._heat.judge(facts), *self._volts.judge(facts)]
        said += self._holds.judge(facts, said)
        if not said:
            self._present.clear()
            self.bars = ()
            return FINE
        self.bars = tuple(one.finding for one in said if one.bars)
        return self._answer(said, facts)

    def _answer(self, said: list[RuleResult], facts: GuardInput) -> GuardDecision:
        """The hardest reaction of all; findings that are new, or alone those that must be latched now."""
        reaction = max(one.reaction for one in said)
        refused = any(one.refuses for one in said)
        causes = tuple(one.finding for one in said if reaction and one.reaction is reaction)
        new = [one for one in said if self._is_new(one, facts.now)]
        latching = [one for one in said if one.latches and (facts.state not in STOPPED or one in new)]
        hard = [one for one in said if one.reaction is Reaction.INHIBIT]
        told = self._new_findings(latching or hard or new, said, facts.now)
        here = {one.finding.joint for one in said if one.here and one.reaction}
        return GuardDecision(
            reaction,
            told,
            bool(latching),
            refused,
            causes,
            pace=min(one.pace for one in said),
            here=tuple(sorted(joint for joint in here if joint is not None)),
            gone=tuple(sorted({one.bus for one in said if one.gone})),
        )

    def _is_new(self, one: RuleResult, now: float) -> bool:
        """Not told while it lasts, and not of a flickering cause so soon again."""
        mere_warning = one.reaction is Reaction.NONE and not one.latches
        quiet = self._bounds.quiet_warning if mere_warning else self._bounds.quiet
        return one.key not in self._present and not now - self._told.get(one.key, -inf) < quiet

    def _new_findings(
        self, telling: list[RuleResult], said: list[RuleResult], now: float
    ) -> tuple[Finding, ...]:
        told = {one.key for one in telling}
        self._present = {one.key for one in said if one.key in told or not self._is_new(one, now)}
        self._told.update(dict.fromkeys(told, now))
        return tuple(one.finding for one in telling)
