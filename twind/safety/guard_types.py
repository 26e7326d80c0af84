"""Input and output of the per-tick gate (docs/safety.md). Pure data."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from twind.robot.arrays import Bools, Floats, Ints
from twind.robot.external_torque import ExternalTorque
from twind.robot.finding import Finding, ReasonCode
from twind.robot.joint_state import JointState
from twind.robot.modes import Mode, Motion, RobotState
from twind.robot.trajectory import Reference
from twind.safety.state_machine import LATCHED

Fence = tuple[Floats, Floats]  # rad (n,): least and largest goal
MOVING = (Motion.ACTIVE, Motion.STREAMING)
# stopping already: a hold would only cut the way to the rest pose short
REACTING = (RobotState.SETTLING, *LATCHED)


class Reaction(IntEnum):
    """Reaction to a finding, in order of severity (docs/safety.md). The hardest of all rules counts."""

    NONE = 0
    HOLD = 1  # brake, then repeat the last goal
    SETTLE = 2  # move to the rest pose, then torque off
    DAMP = 3  # torque stays, soft: gains down, effort capped, follow what is measured, then torque off
    INHIBIT = 4  # write nothing more


@dataclass(frozen=True, slots=True)
class GuardThresholds:
    """Thresholds of the guard that do not depend on the joint (docs/reason-codes.md has their reasons)."""

    late: float = 0.002  # s, a tick that starts later is reported (LOOP_LATE)
    missed_warn: int = 2  # ticks in a row
    missed_hold: int = 5
    # s ... and as long as this: at 500 Hz five ticks are 10 ms, which endangers nothing
    missed_for: float = 0.05
    setpoint_age: float = (
        0.1  # s (STREAM_STALE), as MoveIt Servo and moteus: a hanging client stops the robot
    )
    # s, age of a joint (STATE_STALE): three ticks at 100 Hz, so that one lost reply is no warning
    stale_warn: float = 0.03
    stale_hold: float = 0.1  # s: an older reading may be of a servo that its watchdog (0.1 s) has stopped
    stale_fault: float = 0.5  # s: the joint may be limp, so a free-standing robot is lowered
    # of a second's exchanges of one bus (BUS_ERRORS); what protects the robot is the freshness of each joint
    errors_warn: float = 0.05
    errors_hold: float = 0.2  # share: such a bus is broken, not disturbed by another program
    errors_least: int = 3  # bad exchanges that a share needs to hold: at 20 Hz one alone is 5 %
    errors_row_hold: int = 5  # bad exchanges of one bus in a row; 50 ms without a reading at 100 Hz
    errors_row_fault: int = 20  # the bound of Franka's control interface
    foreign: int = 3  # packets without a request in a second (FOREIGN_TRAFFIC)
    disagreements: int = (
        # refreshes in a row in which torque differs from the commanded one (TORQUE_MISMATCH): one may be
        # older than the command
        2
    )
    clock_slack: float = (
        0.05  # s that a servo's own clock may be off between two readings (SERVO_REBOOTED) ...
    )
    clock_drift: float = 0.05  # ... and of the time between them
    jumps: int = 3  # implausible readings in a row (SENSE_JUMP)
    beyond_hard: float = 0.0087  # rad past the hard limit (OUT_OF_LIMIT)
    full: int = 3  # packets in a row that the port had no room for (TX_BACKLOG)
    line_silent: float = 0.1  # s without a reply on a CAN bus (CAN_BUS_STATE)
    follow: float = 0.2  # rad between position and permitted position of a joint (FOLLOW_ERR) ...
    follow_for: float = 0.1  # s ... for so long
    follow_damp: float = 0.5  # rad: at once, and softer
    lag: float = 0.03  # s that a servo's own loop may be behind a goal that moves
    look: float = 0.05  # s between two checks of conditions that take longer to develop
    frozen_for: float = 0.2  # s with the very same position while goal and motor move (SENSE_FROZEN)
    frozen_moved: float = 0.01  # rad that the goal moves at least, where the servo reports that it turns ...
    frozen_turning: float = 0.1  # rad/s ... as fast as this
    frozen_far: float = 0.1  # rad that the goal moves at least, where only current flows ...
    frozen_load: tuple[float, float] = (
        0.02,
        0.15,
    )  # ... share of the limit, in between: a blocked motor draws more
    overspeed: float = 1.2  # of the velocity limit (OVERSPEED) ...
    overspeed_slack: float = 0.05  # rad/s ... and two steps of the register more
    overspeed_row: int = 2  # readings in a row
    drift: float = 0.05  # rad between the robot and the simulation of the same goals (MIRROR_DRIFT) ...
    drift_for: float = 0.5  # s ... for so long: twice the time of starting and stopping at full speed
    load_warn: float = 0.8  # of the current limit (OVERCURRENT) ...
    load_warn_for: float = 0.5  # s
    load_hold: float = 0.95
    load_hold_for: float = 1.0  # s; after twice that time the hold has not helped: damped
    tired_warn: float = 0.25  # s at the current limit beyond the continuous load (I²t)
    tired_hold: float = 0.5  # leaves the time to react before a servo shuts itself down for overload
    tired_settle: float = 0.8  # holding has not helped
    votes: tuple[int, int] = (3, 5)  # readings of the temperature that must agree, of so many (OVERTEMP)
    spike: float = 10.0  # °C above the other readings: reported, but not used
    warming: float = 0.5  # °C/s ...
    warming_over: float = 5.0  # s ... over so long
    hot_pace: float = 0.5  # share of its speed for a motion of a robot with a hot joint
    volt_for: float = 0.1  # s that the supply must be low (VOLTAGE)
    unread: float = 2.0  # s without a reading of temperature and voltage: reported
    least_pace: float = 0.1  # share of its speed for a motion just before it is held (LOOKAHEAD_COLLISION)
    # s without a tick: the servos' watchdogs are set to that and may have stopped them (TIME_GAP)
    gap: float = 0.1
    # s that a free-standing robot is held after a stop of this daemon; then it is lowered
    hold_most: float = 30.0
    lead_free: float = 0.75  # share of a joint's lead limit from which a motion is slower (LEAD_LIMIT)
    lead_for: float = 2.0  # s that a motion waits for a joint, before it is held
    quiet: float = 1.0  # s before the same finding of the same joint is reported again
    quiet_warning: float = 10.0  # s, for a finding without effect: a noisy wire would fill the log


@dataclass(slots=True)
class BusTraffic:
    """Result of the last tick's exchange on one bus."""

    asked: bool = False  # a reading was requested from devices that are known to be present
    bad: bool = False  # a requested device did not reply, or bytes were discarded (BUS_ERRORS)
    answered: bool = False  # a device replied
    foreign: int = 0  # packets that were not requested (FOREIGN_TRAFFIC)
    full: int = 0  # packets of this daemon that the port had no room for (TX_BACKLOG)
    left_out: bool = False  # others hold, and this bus gets no goals: it was lost before
    line: int = 0  # of a CAN controller: 0 active, 1 error passive, 2 off or unacknowledged (CAN_BUS_STATE)

    def reset(self, *, left_out: bool) -> None:
        """Begin a tick; the state of the line stays."""
        self.left_out = left_out
        self.asked = False
        self.bad = False
        self.answered = False
        self.foreign = 0
        self.full = 0


@dataclass(frozen=True, slots=True)
class ClearanceAhead:
    """Least clearance on the commanded path just ahead, in the model (LOOKAHEAD_COLLISION)."""

    clearance: float  # m between the surfaces of the closest pair; negative: inside each other; inf: far
    ahead: float = 0.0  # s from now until then
    pair: tuple[str, str] = ("", "")  # names of the two bodies
    block: float = 0.0  # m: at a smaller clearance motion is refused
    warn: float = 0.0  # m: at a smaller clearance motion is slower


@dataclass(slots=True)
class GuardInput:
    """Input of one guard decision. Arrays are (n,).

    Not frozen: a frozen one takes three times as long to make.
    """

    now: float  # s
    mode: Mode
    state: RobotState
    motion: Motion
    period: float  # s, nominal
    lateness: float  # s, of this tick's start
    missed_in_a_row: int  # ticks skipped just before this one
    measured: JointState | None  # the state that follows commands; None without one
    goal: Reference | None  # the next goal to be written; None: none
    previous: Floats | None  # rad (n,), the last goal that was sent; None: none since the hold began
    lease_ok: bool  # a client may command, or a procedure of the daemon does
    setpoint_age: float | None  # s; None: the executor ages its setpoints itself
    torque: NDArray[np.int8]  # read back: 1 on, 0 off, -1 unknown
    torque_expected: bool
    torque_settled: bool  # no procedure is changing it
    watchdog: NDArray[np.int16]  # read back, raw; 255 tripped, -1 unknown
    status_time: Floats  # s, when torque and watchdog were read; -inf never
    discarded: int  # bytes thrown away in the last exchange
    traffic: Sequence[BusTraffic]  # of the last exchange, in the order of the buses
    alerts: NDArray[np.uint8]  # error byte of the last status; 0x80: hardware error; 0 without a reply
    fault: NDArray[np.int16]  # hardware error bits as read back; -1 unknown
    tick: NDArray[np.int32]  # ms, the servo's own clock modulo 32768; -1 unknown
    health_time: Floats  # s, when clock, temperature and voltage were read; -inf never
    temperature: Floats  # °C; NaN unknown
    voltage: Floats  # V; NaN unknown
    jumps: Ints  # implausible readings in a row, up to the last one (SENSE_JUMP)
    leaps: Floats  # rad, distance of the last one from the one before
    simulated: JointState | None = None  # the same goals in the model (MIRROR_DRIFT)
    outlook: ClearanceAhead | None = (
        None  # least clearance on the path just ahead (LOOKAHEAD_COLLISION); None: not checked
    )
    # (n,) share of the current limit, NaN unknown; None: unknown for all joints (OVERCURRENT)
    load: Floats | None = None
    limp: Bools | None = None  # joints that stay without torque by request while the others hold; None: none
    external: ExternalTorque | None = None  # (CONTACT, CONTACT_HOLD); None: not observed
    suspended: float = 0.0  # s that the machine has slept since it started (TIME_GAP)
    # torque of this daemon holds the robot: a fault of it is a fault of the robot
    torque_held: bool = field(init=False)
    # torque of this daemon is on, or about to be: a fault must end the arming
    torque_ours: bool = field(init=False)

    def __post_init__(self) -> None:
        live = self.mode is Mode.LIVE
        self.torque_held = live and self.torque_expected
        self.torque_ours = live and (self.torque_expected or self.state is RobotState.ARMING)

    def is_limp(self, joint: int) -> bool:
        """Check that a joint stays without torque by request."""
        return self.limp is not None and bool(self.limp[joint])


@dataclass(frozen=True, slots=True)
class GuardDecision:
    """Decision of one tick. With `latches`, `findings` are exactly the codes to latch."""

    reaction: Reaction = Reaction.NONE
    findings: tuple[Finding, ...] = ()  # to report: those that are new
    latches: bool = False  # the robot goes to FAULT
    goal_refused: bool = False  # this goal must not be written: the last one again, or nothing
    # findings behind the reaction, reported before or not: the reason of a motion that ends
    causes: tuple[Finding, ...] = ()
    pace: float = 1.0  # share of its own speed that the motion may have: 1 freely, less near a bound
    slowing: tuple[ReasonCode, ...] = ()  # codes that slow it
    # Joints that a HOLD holds at their measured position, not at the commanded one (FOLLOW_ERR, OVERCURRENT):
    # a blocked joint would go on pushing.
    here: tuple[int, ...] = ()
    # buses on which no device receives requests (CAN_BUS_STATE): to be emptied and begun anew
    gone: tuple[int, ...] = ()
    fence: Fence | None = field(default=None, compare=False)  # bounds of streamed goals (LEAD_LIMIT)


class Rule(Protocol):
    """One rule of the guard, or several on one subject. Its memory is counters and hysteresis only."""

    def judge(self, facts: GuardInput) -> "Sequence[RuleResult]":
        """Return the results of a tick; empty in the usual case, which must cost little."""


@dataclass(frozen=True, slots=True)
class RuleResult:
    """Result of one rule in one tick."""

    finding: Finding
    reaction: Reaction = Reaction.NONE
    latches: bool = False
    refuses: bool = False  # the goal of this tick
    bars: bool = False  # arming is refused while it lasts
    transient: bool = False  # about this motion or this tick alone: another motion may begin
    bus: int = -1  # place of the bus it is about; -1: no single bus
    pace: float = 1.0  # share of its speed that a motion may have
    here: bool = False  # a HOLD holds this joint where it is measured
    gone: bool = False  # no device on this bus receives requests
    fence: Fence | None = field(default=None, compare=False)  # streamed goals go no further

    @property
    def key(self) -> "Key":
        """Identity of the finding over ticks: rule, joint, threshold and bus."""
        return self.finding.code, self.finding.joint, self.finding.bound, self.bus


def hold_here(facts: GuardInput) -> Reaction:
    """Return HOLD at the measured position, unless the robot is on its way down already."""
    down = facts.state in (RobotState.SETTLING, RobotState.ESTOP) or not facts.torque_settled
    return Reaction.NONE if down else Reaction.HOLD


NOTHING: tuple[RuleResult, ...] = ()
Key = tuple[ReasonCode, int | None, float | None, int]


def detection_lost(message: str) -> RuleResult:
    """Return the report that contacts or falls cannot be detected."""
    return RuleResult(Finding(ReasonCode.DETECTION_LOST, message=message), Reaction.NONE)


def hold(facts: GuardInput) -> Reaction:
    """Return HOLD, unless a harder reaction is under way already."""
    return Reaction.NONE if facts.state in REACTING else Reaction.HOLD
