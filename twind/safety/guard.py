"""The per-tick gate: what may be written now, and how to react to what was read (rules R of docs/safety.md).

Pure: facts in, a judgement out. A goal may only be turned into a hold; stop, hold and torque-off are never
refused. Memory is counters and hysteresis alone: how often a register disagreed, and what was said when.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum
from math import inf, isfinite

import numpy as np
from numpy.typing import NDArray

from twind.robot.arrays import Floats, every, some
from twind.robot.finding import Code, Finding
from twind.robot.limits import Limits
from twind.robot.modes import Mode, Motion, State
from twind.robot.state import JointState
from twind.robot.trajectory import Reference
from twind.safety.states import LATCHED

MOVING = (Motion.ACTIVE, Motion.STREAMING)
REACTING = (State.SETTLING, *LATCHED)  # stopping already: a hold would only cut the way to rest short
UNWRITABLE = (State.IDENTIFYING, State.CONNECTED, State.CALIBRATING, State.INHIBITED)  # W5
TRIPPED = 255  # what a device's watchdog register reads after it has tripped
ROUNDING = 1e-9  # rad: of a goal that moves at exactly the velocity limit


class Reaction(IntEnum):
    """What to do, in order of severity (docs/safety.md). The hardest of all rules counts."""

    NONE = 0
    HOLD = 1  # brake, then repeat the last goal
    SETTLE = 2  # move to the rest pose, then torque off
    INHIBIT = 3  # write nothing more


@dataclass(frozen=True, slots=True)
class Thresholds:
    """The guard's numbers that do not depend on the joint (design 6.4)."""

    late: float = 0.002  # s, a tick that starts later is told (R02)
    missed_warn: int = 2  # ticks in a row
    missed_hold: int = 5
    setpoint_age: float = 0.1  # s (R04)
    stale_warn: float = 0.03  # s, age of a joint (R05)
    stale_hold: float = 0.1
    stale_fault: float = 0.5
    disagreements: int = 2  # refreshes in a row in which torque differs from what was commanded (R10)
    beyond_hard: float = 0.0087  # rad past the hard limit (R14)
    quiet: float = 1.0  # s before the same is said of the same joint again


@dataclass(frozen=True, slots=True)
class Facts:
    """All that one judgement rests on. Arrays are (n,)."""

    now: float  # s
    mode: Mode
    state: State
    motion: Motion
    period: float  # s, nominal
    lateness: float  # s, of this tick's start
    missed_in_a_row: int  # ticks skipped just before this one
    measured: JointState | None  # the target of commands; None where there is none
    goal: Reference | None  # what is about to be written; None: nothing
    previous: Floats | None  # rad, the last goal that was really written; None: none since the hold began
    lease_ok: bool  # somebody may command, or a procedure of our own does
    setpoint_age: float | None  # s; None: the executor ages its setpoints itself
    torque: NDArray[np.int8]  # read back: 1 on, 0 off, -1 unknown
    torque_expected: bool
    torque_settled: bool  # no procedure is changing it
    watchdog: NDArray[np.int16]  # read back, raw; 255 tripped, -1 unknown
    status_time: Floats  # s, when torque and watchdog were read; -inf never
    discarded: int  # bytes thrown away in the last exchange


@dataclass(frozen=True, slots=True)
class Judgement:
    """The answer of one tick. When `latches`, `findings` are exactly the codes to latch."""

    reaction: Reaction = Reaction.NONE
    findings: tuple[Finding, ...] = ()
    latches: bool = False  # the robot goes to FAULT
    goal_refused: bool = False  # this goal must not be written: the last one again, or nothing


@dataclass(frozen=True, slots=True)
class Said:
    """What one rule says of one tick."""

    finding: Finding
    reaction: Reaction = Reaction.NONE
    latches: bool = False
    refuses: bool = False  # the goal of this tick

    @property
    def key(self) -> "Key":
        """What makes it the same as one said before: rule, joint and threshold."""
        return self.finding.code, self.finding.joint, self.finding.bound


Key = tuple[Code, int | None, float | None]
FINE = Judgement()


class Guard:
    """Judges every tick. What it remembers: disagreements of torque per joint, and what was said when."""

    def __init__(self, limits: Limits, thresholds: Thresholds | None = None) -> None:
        self._limits = limits
        self._bounds = thresholds if thresholds is not None else Thresholds()
        self._hard_lower = limits.hard_lower - self._bounds.beyond_hard
        self._hard_upper = limits.hard_upper + self._bounds.beyond_hard
        self._disagreed = np.zeros(len(limits.lower), np.int64)
        self._refreshed = np.full(len(limits.lower), -inf)
        self._present: set[Key] = set()  # said of the last tick, and told then or before
        self._told: dict[Key, float] = {}  # s, when each was last told

    def judge(self, facts: Facts) -> Judgement:
        """The reaction to this tick's facts, and what to tell. Never raises for bad numbers."""
        said = [*self._timing(facts), *self._authority(facts), *self._goal(facts)]
        said += [*self._readings(facts), *self._devices(facts)]
        if not said:
            self._present.clear()
            return FINE
        return self._answer(said, facts)

    # ------------------------------------------------------------------------------- rules

    def _timing(self, facts: Facts) -> Iterator[Said]:
        """R02: late ticks are told, too many missed ones hold. The executor re-times by itself."""
        bounds, missed = self._bounds, facts.missed_in_a_row
        if missed >= bounds.missed_hold:
            yield Said(_late(missed, bounds.missed_hold, "ticks missed in a row: holding"), _hold(facts))
        elif missed >= bounds.missed_warn:
            yield Said(_late(missed, bounds.missed_warn, "ticks missed in a row"))
        elif not facts.lateness <= bounds.late:
            yield Said(_late(facts.lateness, bounds.late, "s that the tick began late"))

    def _authority(self, facts: Facts) -> Iterator[Said]:
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

    def _goal(self, facts: Facts) -> Iterator[Said]:
        """R21 and NaN: what is written is finite, and within one step of what was written last."""
        if facts.goal is None:
            return
        goal = facts.goal.position
        if not isfinite(float(goal @ goal)):
            joint = int(np.argmin(np.isfinite(goal)))
            finding = Finding(Code.NONFINITE, joint, message="a goal that is no number: holding the last one")
            yield Said(finding, Reaction.HOLD, refuses=True)
        elif facts.previous is not None:
            step = np.abs(goal - facts.previous)
            fits = step <= self._limits.velocity * facts.period + ROUNDING
            if not every(fits):
                joint = int(np.argmin(fits))
                bound = float(self._limits.velocity[joint]) * facts.period
                message = "rad in one tick: holding the last goal (a bug of ours)"
                finding = Finding(
                    Code.STEP_LIMIT, joint, value=float(step[joint]), bound=bound, message=message
                )
                yield Said(finding, Reaction.HOLD, refuses=True)

    def _readings(self, facts: Facts) -> Iterator[Said]:
        """R05 and R14: every joint is heard, and inside its limits."""
        measured, limits = facts.measured, self._limits
        if measured is None:
            if _held(facts):
                yield Said(Finding(Code.STATE_STALE, message="no reading at all: holding"), _hold(facts))
            return
        age = measured.age + (facts.now - measured.time)
        if not every(age <= self._bounds.stale_warn):
            yield from self._stale(facts, age)
        position = measured.position
        if not every((position >= limits.lower) & (position <= limits.upper)):
            yield from self._beyond(facts, position)
            yield from self._outward(facts, position)

    def _stale(self, facts: Facts, age: Floats) -> Iterator[Said]:
        bounds = self._bounds
        for joint in np.flatnonzero(~(age <= bounds.stale_warn)).tolist():
            value = float(age[joint])
            bound, reaction = bounds.stale_warn, Reaction.NONE
            if not value <= bounds.stale_fault:
                bound, reaction = bounds.stale_fault, Reaction.SETTLE
            elif not value <= bounds.stale_hold:
                bound, reaction = bounds.stale_hold, _hold(facts)
            finding = Finding(
                Code.STATE_STALE, joint, value=value, bound=bound, message="s since it answered"
            )
            if _held(facts):
                yield Said(finding, reaction, latches=reaction is Reaction.SETTLE)
            else:
                yield Said(finding)

    def _beyond(self, facts: Facts, position: Floats) -> Iterator[Said]:
        """R14: past the hard limit. A joint that was never heard (NaN) is R05's."""
        low, high = position < self._hard_lower, position > self._hard_upper
        for joint in np.flatnonzero(low | high).tolist():
            bound = float((self._hard_lower if low[joint] else self._hard_upper)[joint])
            message = "past the hard limit: move it inside by hand, check its calibration"
            finding = Finding(
                Code.OUT_OF_LIMIT, joint, value=float(position[joint]), bound=bound, message=message
            )
            if _held(facts):
                yield Said(finding, _hold(facts), latches=True)
            else:
                yield Said(finding)

    def _outward(self, facts: Facts, position: Floats) -> Iterator[Said]:
        """R14: past a limit a motion may only lead inwards. A hold or a stop is never refused."""
        if facts.goal is None or facts.previous is None or facts.motion not in MOVING:
            return
        goal, previous, limits = facts.goal.position, facts.previous, self._limits
        above = (position > limits.upper) & (goal > limits.upper) & (goal > previous + ROUNDING)
        below = (position < limits.lower) & (goal < limits.lower) & (goal < previous - ROUNDING)
        for joint in np.flatnonzero(above | below).tolist():
            bound = float((limits.upper if above[joint] else limits.lower)[joint])
            message = "past its limit it may only move inwards: holding the last goal"
            finding = Finding(
                Code.OUT_OF_LIMIT, joint, value=float(goal[joint]), bound=bound, message=message
            )
            yield Said(finding, Reaction.HOLD, refuses=True)

    def _devices(self, facts: Facts) -> Iterator[Said]:
        """R07, R10 and R12: what the bus and the registers of the devices say."""
        if facts.discarded:
            message = "bytes that were no answer of ours were dropped"
            yield Said(Finding(Code.RX_SHAPE, value=float(facts.discarded), message=message))
        if not _held(facts):
            self._disagreed[:] = 0
            return
        tripped = facts.watchdog == TRIPPED
        if some(tripped):
            for joint in np.flatnonzero(tripped).tolist():
                message = "its watchdog tripped and it takes no goals: disarm, reset, arm"
                finding = Finding(Code.WATCHDOG_TRIPPED, joint, value=float(TRIPPED), message=message)
                yield Said(finding, _hold(facts), latches=True)
        yield from self._torque(facts)

    def _torque(self, facts: Facts) -> Iterator[Said]:
        """R10: torque that reads back off, or unknown, in too many refreshes in a row."""
        fresh = facts.status_time > self._refreshed
        if some(fresh):
            self._refreshed = facts.status_time.copy()
            wrong = fresh & (facts.torque != 1)
            self._disagreed[fresh & ~wrong] = 0
            if some(wrong):
                self._disagreed[wrong] += 1
        if not facts.torque_settled:
            self._disagreed[:] = 0
        elif some(self._disagreed > 0):
            for joint in np.flatnonzero(self._disagreed >= self._bounds.disagreements).tolist():
                message = "torque reads back off (0) or unknown (-1) while armed"
                value = float(facts.torque[joint])
                finding = Finding(Code.TORQUE_MISMATCH, joint, value=value, bound=1.0, message=message)
                yield Said(finding, _hold(facts), latches=True)

    # ------------------------------------------------------------------------------- answer

    def _answer(self, said: list[Said], facts: Facts) -> Judgement:
        """The hardest reaction of all; findings that are new, or alone those that must be latched now."""
        reaction = max(one.reaction for one in said)
        refused = any(one.refuses for one in said)
        new = [one for one in said if self._is_new(one.key, facts.now)]
        latching = [one for one in said if one.latches and (facts.state not in LATCHED or one in new)]
        if latching:
            return Judgement(reaction, self._tell(latching, said, facts.now), True, refused)
        hard = [one for one in said if one.reaction is Reaction.INHIBIT]
        return Judgement(reaction, self._tell(hard or new, said, facts.now), False, refused)

    def _is_new(self, key: Key, now: float) -> bool:
        """Not told while it lasts, and not told of a flickering cause within `quiet` s."""
        return key not in self._present and not now - self._told.get(key, -inf) < self._bounds.quiet

    def _tell(self, telling: list[Said], said: list[Said], now: float) -> tuple[Finding, ...]:
        told = {one.key for one in telling}
        self._present = {one.key for one in said if one.key in told or not self._is_new(one.key, now)}
        self._told.update(dict.fromkeys(told, now))
        return tuple(one.finding for one in telling)


def _held(facts: Facts) -> bool:
    """Our torque holds the robot: a fault of it is a fault of the robot."""
    return facts.mode is Mode.LIVE and facts.torque_expected


def _hold(facts: Facts) -> Reaction:
    """HOLD, but where a harder reaction is under way already."""
    return Reaction.NONE if facts.state in REACTING else Reaction.HOLD


def _late(value: float, bound: float, message: str) -> Finding:
    return Finding(Code.LOOP_LATE, value=float(value), bound=float(bound), message=message)
