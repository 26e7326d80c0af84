"""The per-tick gate: judges the goal of a tick and the readings (docs/reason-codes.md).

Pure: inputs in, a decision out. A goal may only be turned into a hold; stop, hold and torque-off are never
refused. The rules stand by subject in the modules `..._rules`; here they are collected and reported. Its
memory is counters and hysteresis only.
"""

from collections.abc import Mapping, Sequence
from math import inf

from twind.robot.actuator_ratings import ActuatorRatings
from twind.robot.arrays import Floats
from twind.robot.finding import Finding
from twind.robot.joint_limits import JointLimits
from twind.robot.modes import RobotState
from twind.robot.transmission import MappedTransmission
from twind.safety.bus_rules import BusRules
from twind.safety.can_line_rules import LineRules
from twind.safety.clearance_rules import LookaheadCollisionRules
from twind.safety.contact_rules import ContactRules
from twind.safety.device_rules import DeviceRules
from twind.safety.fall_rules import FallRules
from twind.safety.follow_bounds import follow_bounds
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
    Rule,
    RuleResult,
)
from twind.safety.heat_rules import HeatRules
from twind.safety.joint_reading_rules import ReadingRules
from twind.safety.lead_rules import LeadRules, TorqueAtRest
from twind.safety.power_rules import CurrentRules, VoltageRules
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
# a latch is in force already: findings are reported like any others
STOPPED = (*LATCHED, RobotState.INHIBITED)


class Guard:
    """Guard of every tick; its memory: when each finding was last reported."""

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
        at_rest: TorqueAtRest | None = None,
        load: Floats | None = None,
        falls: FallRules | None = None,
        contact: ContactRules | None = None,
    ) -> None:
        """`buses`: names in the order of `GuardInput.traffic`. `can`: joints by CAN bus.

        `support`: of the robot file. `ratings`: bounds of the actuators; without them supply, heat and load
        are not judged. `linked`: transmissions, whose actuators turn joints together. `at_rest`: torque that
        holds a pose; None: unknown (LEAD_LIMIT). `load` (n,): N·m, the largest that a joint holds at rest;
        None: unknown (FOLLOW_ERR). `falls`: None: the robot file does not ask for fall detection.
        `contact`: None for a robot without observer of external torque.
        """
        self._bounds = bounds = thresholds if thresholds is not None else GuardThresholds()
        rated = ratings if ratings is not None else ActuatorRatings.unknown(len(limits.lower))
        free = support not in ("fixed", "gantry")
        lines = can if can is not None else {}
        on_can = frozenset(joint for joints in lines.values() for joint in joints)
        self._free = free
        self._linked = linked
        self.contact = contact  # rules on torque from outside
        self._at_rest = at_rest
        self._load = load
        self._goals, readings, tracking, *leads = self._limited(limits, rated)
        self.devices = DeviceRules(rated.leg, free, bounds, on_can)
        # All rules of every tick, in the order of their findings; a new rule is added here.
        self._rules: tuple[Rule, ...] = (
            TimeGapRules(bounds),
            self._goals,
            LookaheadCollisionRules(bounds),
            readings,
            tracking,
            *leads,
            *((contact,) if contact is not None else ()),
            BusRules(buses, bounds),
            LineRules(buses, lines, free, bounds),
            self.devices,
            CurrentRules(rated, bounds),
            HeatRules(rated, bounds),
            VoltageRules(rated, bounds),
            *((falls,) if falls is not None else ()),
        )
        self.falls = falls
        self._holds = HoldRules(free, bounds)  # judges the results of the others
        self._present: set[Key] = set()  # present in the last tick, and reported then or before
        self._reported_at: dict[Key, float] = {}  # s, when each was last reported
        # findings of the last tick that prevent arming, and those that hold any motion
        self.bars: tuple[Finding, ...] = ()
        self._holding: tuple[Finding, ...] = ()

    @property
    def bounds(self) -> GuardThresholds:
        """The thresholds of all rules."""
        return self._bounds

    @property
    def follow(self) -> Floats:
        """Distance from each joint to its goal (n,), rad, from which on FOLLOW_ERR counts."""
        return self._following.rad

    def limit(self, limits: JointLimits, ratings: ActuatorRatings) -> None:
        """Use these values from now on, for a robot at rest. The memory of all other rules is kept."""
        limited = self._limited(limits, ratings)
        self._goals = limited[0]
        anew: dict[type, Rule] = {type(rule): rule for rule in limited}
        self._rules = tuple(anew.get(type(rule), rule) for rule in self._rules)

    def _limited(
        self, limits: JointLimits, rated: ActuatorRatings
    ) -> tuple[GoalRules, ReadingRules, TrackingRules, *tuple[LeadRules, ...]]:
        """Return the rules that depend on limits and gains. Leads count for devices without a watchdog."""
        self._following = follow_bounds(rated, limits, self._load, self._bounds)
        leads = LeadRules(limits, rated, self._bounds, self._at_rest)
        return (
            GoalRules(limits, self._bounds),
            ReadingRules(limits, self._bounds, self._free),
            TrackingRules(limits, self._bounds, self._following, self._linked),
            *((leads,) if leads.applies else ()),
        )

    def judge(self, facts: GuardInput) -> GuardDecision:
        """Return the reaction to this tick's input, and the findings to report.

        Never raises for bad numbers.
        """
        results: list[RuleResult] = []
        for rule in self._rules:
            if found := rule.judge(facts):
                results += found
        results += self._holds.judge(facts, results)
        if not results:
            if self._present:
                self._present.clear()
            self.bars = () if self.falls is None else self.falls.bars
            self._holding = ()
            return FINE
        self.bars = tuple(one.finding for one in results if one.bars)
        if self.falls is not None:
            self.bars += self.falls.bars
        self._holding = tuple(one.finding for one in results if one.reaction and not one.transient)
        return self._answer(results, facts)

    def holding(self, missed: int, period: float) -> tuple[Finding, ...]:
        """Return the findings for which a motion that begins now would be held in this tick.

        `missed`: ticks in a row just before this one. `period`: s.
        """
        late = self._goals.many_missed(missed, period)
        return self._holding if late is None else (*self._holding, late)

    def _answer(self, results: list[RuleResult], facts: GuardInput) -> GuardDecision:
        """Return the hardest reaction; findings that are new, or only those that must be latched now."""
        reaction = max(one.reaction for one in results)
        refused = any(one.refuses for one in results)
        causes = tuple(one.finding for one in results if reaction and one.reaction is reaction)
        new = [one for one in results if self._is_new(one, facts.now)]
        latching = [one for one in results if one.latches and (facts.state not in STOPPED or one in new)]
        hard = [one for one in results if one.reaction is Reaction.INHIBIT]
        findings = self._new_findings(latching or hard or new, results, facts.now)
        here = {one.finding.joint for one in results if one.here and one.reaction}
        return GuardDecision(
            reaction,
            findings,
            bool(latching),
            refused,
            causes,
            pace=min(one.pace for one in results),
            slowing=tuple(dict.fromkeys(one.finding.code for one in results if one.pace < 1.0)),
            here=tuple(sorted(joint for joint in here if joint is not None)),
            gone=tuple(sorted({one.bus for one in results if one.gone})),
            fence=next((one.fence for one in results if one.fence is not None), None),
        )

    def _is_new(self, one: RuleResult, now: float) -> bool:
        """Check that a finding is to be reported: not while it lasts, and not soon again when it flickers."""
        mere_warning = one.reaction is Reaction.NONE and not one.latches
        quiet = self._bounds.quiet_warning if mere_warning else self._bounds.quiet
        return one.key not in self._present and not now - self._reported_at.get(one.key, -inf) < quiet

    def _new_findings(
        self, reported: list[RuleResult], results: list[RuleResult], now: float
    ) -> tuple[Finding, ...]:
        keys = {one.key for one in reported}
        self._present = {one.key for one in results if one.key in keys or not self._is_new(one, now)}
        self._reported_at.update(dict.fromkeys(keys, now))
        return tuple(one.finding for one in reported)
