"""What the per-tick gate judges, and the form of its answers (docs/safety.md). Pure data."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from twind.robot.arrays import Floats, Ints
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Mode, Motion, RobotState
from twind.robot.state import JointState
from twind.robot.trajectory import Reference
from twind.safety.state_machine import LATCHED

MOVING = (Motion.ACTIVE, Motion.STREAMING)
REACTING = (RobotState.SETTLING, *LATCHED)  # stopping already: a hold would only cut the way to rest short


class Reaction(IntEnum):
    """What to do, in order of severity (docs/safety.md). The hardest of all rules counts."""

    NONE = 0
    HOLD = 1  # brake, then repeat the last goal
    SETTLE = 2  # move to the rest pose, then torque off
    DAMP = 3  # torque stays, soft: gains down, effort capped, follow what is measured, then torque off
    INHIBIT = 4  # write nothing more


@dataclass(frozen=True, slots=True)
class GuardThresholds:
    """The guard's numbers that do not depend on the joint (design 6.4)."""

    late: float = 0.002  # s, a tick that starts later is told (LOOP_LATE)
    missed_warn: int = 2  # ticks in a row
    missed_hold: int = 5
    missed_for: float = 0.05  # s ... and as long as this: at 500 Hz five are 10 ms, which is nothing
    setpoint_age: float = 0.1  # s (STREAM_STALE)
    stale_warn: float = 0.03  # s, age of a joint (STATE_STALE)
    stale_hold: float = 0.1
    stale_fault: float = 0.5
    errors_warn: float = 0.01  # of a second's exchanges of one bus (BUS_ERRORS)
    errors_hold: float = 0.05
    errors_least: int = 3  # that a share holds for: at 20 Hz one alone is 5 %
    errors_row_hold: int = 5  # bad exchanges of one bus in a row
    errors_row_fault: int = 20
    foreign: int = 3  # packets of nobody in a second (FOREIGN_TRAFFIC)
    disagreements: int = (
        2  # refreshes in a row in which torque differs from what was commanded (TORQUE_MISMATCH)
    )
    clock_slack: float = (
        0.05  # s that a servo's own clock may be off between two readings (SERVO_REBOOTED) ...
    )
    clock_drift: float = 0.05  # ... and of the time between them
    jumps: int = 3  # readings in a row that cannot be (SENSE_JUMP)
    beyond_hard: float = 0.0087  # rad past the hard limit (OUT_OF_LIMIT)
    full: int = 3  # packets in a row that the port had no room for (TX_BACKLOG)
    line_silent: float = 0.1  # s that nobody on a CAN bus answers (CAN_BUS_STATE)
    follow: float = 0.2  # rad between where a joint is and where its goal lets it be (FOLLOW_ERR) ...
    follow_for: float = 0.1  # s ... for so long
    follow_damp: float = 0.5  # rad: at once, and softer
    lag: float = 0.03  # s that a servo's own loop may be behind a goal that moves
    look: float = 0.05  # s between two looks at what takes longer than that to go wrong
    frozen_for: float = 0.2  # s with the very same position while goal and motor move (SENSE_FROZEN)
    frozen_moved: float = 0.01  # rad that the goal moves at least, where the servo says that it turns ...
    frozen_turning: float = 0.1  # rad/s ... as fast as this
    frozen_far: float = 0.1  # rad that the goal moves at least, where only current flows ...
    frozen_load: tuple[float, float] = (
        0.02,
        0.15,
    )  # ... of the limit, in between: a blocked motor draws more
    overspeed: float = 1.2  # of the velocity limit (OVERSPEED) ...
    overspeed_slack: float = 0.05  # rad/s ... and two steps of the register more
    overspeed_row: int = 2  # readings in a row
    drift: float = 0.05  # rad between the robot and the simulation of the same goals (MIRROR_DRIFT) ...
    drift_for: float = 0.5  # s ... for so long: twice of what starting and stopping at full speed takes
    load_warn: float = 0.8  # of the current limit (OVERCURRENT) ...
    load_warn_for: float = 0.5  # s
    load_hold: float = 0.95
    load_hold_for: float = 1.0  # s; twice that, and the hold has not helped: damped
    tired_warn: float = 0.25  # s at the current limit beyond what is borne for ever (I²t)
    tired_hold: float = 0.5  # leaves the time to give way before a servo shuts itself down for overload
    tired_settle: float = 0.8  # holding has not helped
    votes: tuple[int, int] = (3, 5)  # readings of the temperature that must agree, of so many (OVERTEMP)
    spike: float = 10.0  # °C above what the others say: told, believed by nobody
    warming: float = 0.5  # °C/s ...
    warming_over: float = 5.0  # s ... over so long
    hot_pace: float = 0.5  # of its speed for a motion of a robot with a hot joint
    volt_for: float = 0.1  # s that the supply is low for (VOLTAGE)
    unread: float = 2.0  # s without a reading of temperature and voltage: told
    least_pace: float = (
        0.1  # of its speed for a motion just before it is held for what is ahead (LOOKAHEAD_COLLISION)
    )
    gap: float = 0.1  # s without a tick: the servos' watchdogs are set to that (TIME_GAP)
    hold_most: float = 30.0  # s that a free-standing robot is held after a stop of ours, then it is lowered
    quiet: float = 1.0  # s before the same is said of the same joint again
    quiet_warning: float = 10.0  # s, where it changes nothing: a noisy wire would fill the log


@dataclass(slots=True)
class BusTraffic:
    """What the last tick's exchange of one bus brought."""

    asked: bool = False  # a reading was asked for, of devices that are known to be there
    bad: bool = False  # a device that was asked was not heard, or bytes were thrown away (BUS_ERRORS)
    answered: bool = False  # somebody was heard
    foreign: int = 0  # packets that nobody asked for (FOREIGN_TRAFFIC)
    full: int = 0  # packets of ours that the port had no room for (TX_BACKLOG)
    left_out: bool = False  # others hold, and this one gets no goals: it was lost before
    line: int = 0  # of a CAN controller: 0 active, 1 error passive, 2 off or unacknowledged (CAN_BUS_STATE)


@dataclass(frozen=True, slots=True)
class ClearanceAhead:
    """The tightest place on the commanded way just ahead, as the model sees it (LOOKAHEAD_COLLISION)."""

    clearance: float  # m between the surfaces of the closest pair; negative: inside each other; inf: far
    ahead: float = 0.0  # s from now until then
    pair: tuple[str, str] = ("", "")  # names of the two bodies
    block: float = 0.0  # m: closer is no way at all
    warn: float = 0.0  # m: closer is taken slowly


@dataclass(frozen=True, slots=True)
class GuardInput:
    """All that one judgement rests on. Arrays are (n,)."""

    now: float  # s
    mode: Mode
    state: RobotState
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
    traffic: Sequence[BusTraffic]  # of the last exchange, in the order of the buses
    alerts: NDArray[np.uint8]  # error byte of the last status; 0x80: hardware error; 0 where not heard
    fault: NDArray[np.int16]  # hardware error bits as read back; -1 unknown
    tick: NDArray[np.int32]  # ms, the servo's own clock modulo 32768; -1 unknown
    health_time: Floats  # s, when clock, temperature and voltage were read; -inf never
    temperature: Floats  # °C; NaN unknown
    voltage: Floats  # V; NaN unknown
    jumps: Ints  # readings in a row, up to the last one, that could not be (SENSE_JUMP)
    leaps: Floats  # rad, by how much the last one was off the one before
    simulated: JointState | None = None  # the same goals in the model (MIRROR_DRIFT)
    outlook: ClearanceAhead | None = (
        None  # the least clearance on the way just ahead (LOOKAHEAD_COLLISION); None: not looked
    )
    load: Floats | None = None  # (n,) share of the current limit, NaN unknown; None: of nobody (OVERCURRENT)
    suspended: float = 0.0  # s that the machine has slept since it started (TIME_GAP)


@dataclass(frozen=True, slots=True)
class GuardDecision:
    """The answer of one tick. When `latches`, `findings` are exactly the codes to latch."""

    reaction: Reaction = Reaction.NONE
    findings: tuple[Finding, ...] = ()  # to tell: those that are new
    latches: bool = False  # the robot goes to FAULT
    goal_refused: bool = False  # this goal must not be written: the last one again, or nothing
    causes: tuple[Finding, ...] = ()  # of the reaction, told before or not: a motion that ends says why
    pace: float = 1.0  # share of its own speed that the motion may have: 1 freely, less near a bound
    # Joints that a HOLD holds where they are measured, not as commanded (FOLLOW_ERR, OVERCURRENT).
    here: tuple[int, ...] = ()
    gone: tuple[int, ...] = ()  # buses on which nobody hears us (CAN_BUS_STATE): to be emptied and begun anew


@dataclass(frozen=True, slots=True)
class RuleResult:
    """What one rule says of one tick."""

    finding: Finding
    reaction: Reaction = Reaction.NONE
    latches: bool = False
    refuses: bool = False  # the goal of this tick
    bars: bool = False  # nobody arms while it is so
    bus: int = -1  # place of the bus it is about; -1: of none alone
    pace: float = 1.0  # share of its speed that a motion may have
    here: bool = False  # a HOLD holds this joint where it is measured
    gone: bool = False  # nobody hears us on this bus

    @property
    def key(self) -> "Key":
        """What makes it the same as one said before: rule, joint, threshold and bus."""
        return self.finding.code, self.finding.joint, self.finding.bound, self.bus


def hold_here(facts: GuardInput) -> Reaction:
    """HOLD where measured, after a latch too: but where the robot is on its way down already."""
    down = facts.state in (RobotState.SETTLING, RobotState.ESTOP) or not facts.torque_settled
    return Reaction.NONE if down else Reaction.HOLD


Key = tuple[ReasonCode, int | None, float | None, int]


def is_torque_held(facts: GuardInput) -> bool:
    """Our torque holds the robot: a fault of it is a fault of the robot."""
    return facts.mode is Mode.LIVE and facts.torque_expected


def is_torque_ours(facts: GuardInput) -> bool:
    """The same, or is just about to: what is wrong must end the arming."""
    return facts.mode is Mode.LIVE and (facts.torque_expected or facts.state is RobotState.ARMING)


def hold(facts: GuardInput) -> Reaction:
    """HOLD, but where a harder reaction is under way already."""
    return Reaction.NONE if facts.state in REACTING else Reaction.HOLD
