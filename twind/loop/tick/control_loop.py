"""The loop: its tick and its state. Runs in the daemon's main process, in one thread.

No asyncio, no files, no logging: reports leave by the link. Time is an argument below `run`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from math import floor, nan
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from twind.loop.ipc.responder import Responder
from twind.loop.procedures import arming, command_handlers
from twind.loop.procedures.calibrating_state import CalibratingState
from twind.loop.procedures.estop_replies import EStopReplies
from twind.loop.procedures.homing_procedure import HomingProcedure
from twind.loop.procedures.identification import IdentificationState, Judge
from twind.loop.procedures.procedure_runner import Priority, ProcedureRunner
from twind.loop.procedures.reload_coordinator import ReloadCoordinator
from twind.loop.procedures.torque_state import TorqueState
from twind.loop.process.realtime import Granted
from twind.loop.tick.guard_input import facts
from twind.loop.tick.loop_figures import LoopFigures
from twind.loop.tick.reactions import react
from twind.loop.tick.state_publisher import StatePublisher
from twind.robot.arrays import Floats
from twind.robot.event_codes import EventCode
from twind.robot.finding import Finding, ReasonCode, Verdict
from twind.robot.joint_state import JointState
from twind.robot.modes import Mode, Motion, RobotState
from twind.robot.trajectory import Reference
from twind.safety import admission, gate
from twind.safety.guard import Guard
from twind.safety.headroom import JointCondition
from twind.safety.state_machine import LATCHED, TABLE, RobotEvent, StateLatch
from twind.telemetry.command_latency import STREAM, CommandLatencyTracer

if TYPE_CHECKING:
    from twind.loop.bus.bus_port import Enabler
    from twind.loop.bus.hardware import Hardware
    from twind.loop.ipc.front_link import ControlLink
    from twind.loop.process.service_notify import Notifier
    from twind.loop.tick.bound_robot import BoundRobot
    from twind.loop.tick.collision_lookahead import CollisionLookahead
    from twind.motion.trajectory_executor import TrajectoryExecutor
    from twind.robot.actuator_ratings import ActuatorRatings
    from twind.robot.joint_limits import JointLimits
    from twind.robot.joint_map import JointMap
    from twind.safety.lease import Lease
    from twind.telemetry.timing_monitor import TimingMonitor
    from twind.twin.twin import Twin
    from twind_drivers.clock import Clock

QUIET = 0.3  # s without a packet after an inhibit: any packet would feed the servos' watchdogs (0.1 s)
GONE = 0.5  # s without a reading after which a servo's torque counts as unknown
PATIENCE = 3  # ticks in a row that may fail with an exception before the daemon ends (INTERNAL)


@dataclass(frozen=True, slots=True)
class LoopParts:
    """Parts of a loop; `assembly` puts them together."""

    clock: Clock
    period: float  # s
    joints: JointMap
    limits: JointLimits
    ratings: ActuatorRatings
    rest: Floats  # rad, (n,)
    support: str
    hardware: Hardware
    twin: Twin
    executor: TrajectoryExecutor
    guard: Guard
    lease: Lease
    health: TimingMonitor
    thresholds: gate.GateThresholds
    link: ControlLink
    notifier: Notifier
    realtime: Mapping[str, Granted]
    judge: Judge  # devices -> findings of CALIB_MISMATCH
    live_denied: Finding | None  # reason why mode live is refused; None: it is allowed
    one: BoundRobot  # source of joints, limits and ratings
    rewire: Callable[[BoundRobot], Enabler] | None = (
        None  # how write halves are made for a robot that was changed
    )
    outlook: CollisionLookahead | None = None  # None: no two bodies of the model can collide


class Loop:
    """State of the daemon: everything a tick reads and writes."""

    def __init__(self, parts: LoopParts, mode: Mode) -> None:
        self.parts = parts
        self.clock = parts.clock
        self.period = parts.period
        self.joints = parts.joints
        self.limits = parts.limits
        self.rest = parts.rest
        self.support = parts.support
        self.hardware = parts.hardware
        self.twin = parts.twin
        self.executor = parts.executor
        self.lease = parts.lease
        self.health = parts.health
        self.link = parts.link
        self.outlook = parts.outlook
        self.way = CommandLatencyTracer(parts.health)
        self.say = Responder(parts.link, parts.clock)
        self.procedures = ProcedureRunner()
        self.stops = EStopReplies(self)
        self.submissions = command_handlers.SubmissionTracker(self)
        self.reloads = ReloadCoordinator(self)
        self.calibrating, self.homing = CalibratingState(self), HomingProcedure(self)
        self.figures = LoopFigures(parts.period, parts.realtime)
        self.publisher = StatePublisher(self)
        self.mode = mode
        self.condition = StateLatch()
        self.latches: dict[ReasonCode, Finding] = {}
        self.identity = IdentificationState(self, parts.judge)
        self.torque = TorqueState(len(parts.joints))
        self.finished = False
        self.unreachable: Finding | None = None  # why no new client can connect; None: clients can
        self.arming_client = 0  # client whose Arm is under way
        self.motion_epoch = -1  # of the lease under which the motion was accepted
        self._resets = 0  # resets of the simulation reported so far
        self.stop_wanted = False  # SIGTERM: lower the robot, then end
        self.untouched = True  # the simulation has not moved since the mode was entered
        self.written: Floats | None = None  # the last goal that was sent, rad (n,)
        self.lateness = 0.0
        self.missed_in_a_row = 0
        self._failures = 0
        still = np.zeros(len(parts.joints))
        never = np.full(len(parts.joints), np.inf)
        self.measured = JointState(
            self.clock.now(), still * nan, still * nan, still * nan, never, still > 0.0, nan
        )
        self.simulated = self.twin.update(None, None, self.clock.now())
        self.enter(mode)

    # ------------------------------------------------------------------------------- time

    def run(self, until: float = np.inf) -> None:
        """Tick at absolute deadlines until finished. A missed tick is counted and never caught up."""
        deadline = self.clock.now()
        while not self.finished and deadline < until:
            self.clock.sleep_until(deadline)
            now = self.clock.now()
            self.lateness = now - deadline
            self._attempt(now)
            deadline += self.period
            behind = floor((self.clock.now() - deadline) / self.period) + 1
            self.missed_in_a_row = max(0, behind)
            deadline += self.missed_in_a_row * self.period
            self.figures.tick(self.lateness, self.missed_in_a_row)

    def tick(self, now: float) -> None:
        """Run one period: commands, procedures, gate, exchange, twin, reports."""
        command_handlers.serve(self, now)
        self.procedures.step(now)
        live = self.mode is Mode.LIVE
        target = self.measured if live else self.simulated  # the state that follows commands and is judged
        goal = self.guard(self.executor.goal(now), target, now)
        self.measured = self.hardware.exchange(goal if live and self.torque.armed else None, now)
        left = goal if self.hardware.left or not live else None
        self.written = self.written if left is None else left
        read = self.clock.now()
        self.simulated = self.twin.update(self.measured, goal, now)
        self._observe(now, read)
        self._follow(left, target, self.hardware.sent if live else read)
        self.publisher.publish(now)

    def _attempt(self, now: float) -> None:
        """Run a tick; hold the last goal after an exception, give up after several in a row (INTERNAL)."""
        try:
            self.tick(now)
        except Exception as error:
            self._failures += 1
            if self._failures >= PATIENCE:
                self.inhibit(Finding(ReasonCode.INTERNAL, message=repr(error)), now)
                raise
            self.fail(Finding(ReasonCode.INTERNAL, message=repr(error)), now)
        else:
            self._failures = 0
            # Only a complete tick feeds the service manager's watchdog: else it restarts the daemon.
            self.parts.notifier.alive(now)

    # ------------------------------------------------------------------------------- the per-tick gate

    def guard(self, reference: Reference | None, target: JointState, now: float) -> Floats | None:
        """Return what may be written this tick: the goal, the last goal again, or nothing (None)."""
        judgement = self.parts.guard.judge(facts(self, reference, target, now))
        return react(self, judgement, reference, now)

    # ------------------------------------------------------------------------------- state

    def enter(self, mode: Mode) -> None:
        """Enter a mode: open or close ports, and set the start position of commands."""
        self.mode = mode
        self.written = None
        self.way.forget()
        self.hardware.access(read=mode is not Mode.SIM, write=mode is Mode.LIVE)
        if mode is Mode.SIM and self.state not in (RobotState.DISCONNECTED, *LATCHED):
            self.change(RobotEvent.PORT_LOST, self.clock.now())
        self.executor.idle()
        if mode is not Mode.LIVE:
            whole = mode is Mode.MIRROR and bool(np.isfinite(self.measured.position).all())
            limits = self.limits  # a robot without a calibration may read whole turns beyond them
            measured = np.clip(self.measured.position, limits.hard_lower, limits.hard_upper)
            place = measured if whole else self.simulated.position
            self.twin.place(place)
            self.executor.begin(place)

    def change(self, event: RobotEvent, now: float, stop: str = "") -> None:
        """Apply an event to the robot's state and report a change. `stop`: as in `link.Event`."""
        before = self.state
        self.condition = self.condition.after(event)
        if self.state is not before:
            self.publisher.urgent = True
            message = f"{before.value} → {self.state.value} ({event.value})"
            cause = event.name.lower()
            self.say.event("info", self.state, message, before=before.value, cause=cause, stop=stop)

    def change_if(self, event: RobotEvent, now: float) -> None:
        """Apply an event where the state allows it; torque off must not depend on the state."""
        if self.state in TABLE[event]:
            self.change(event, now)

    def latch(self, finding: Finding) -> None:
        """Keep a fault until an operator acknowledges it: the first of its code, or the same with a value."""
        first = self.latches.get(finding.code)
        if first is None or (first.joint == finding.joint and first.value is None):
            self.latches[finding.code] = finding
            self.publisher.urgent = True

    def fail(self, finding: Finding, now: float) -> None:
        """Handle an internal fault: hold the last goal, latch, report. A robot on its way down goes on."""
        self.say.event("error", finding.code, finding.message, (finding,), stop="hold")
        self.latch(finding)
        self.change(RobotEvent.FAULT, now)
        if self.procedures.rank is None or self.procedures.rank <= Priority.ARM:
            if self.written is not None and self.executor.motion is not Motion.IDLE:
                self.executor.begin(self.written)
            if self.procedures.rank is Priority.ARM:
                self.procedures.own(Priority.DISARM, lambda: arming.give_up(self))

    def inhibit(self, finding: Finding, now: float) -> None:
        """Write nothing until the servos' own watchdogs have ended the motion; torque stays.

        A procedure that lowers the robot ends: to go on would write, to release would drop the robot. Torque
        that is being switched on or off already goes off.
        """
        self.torque.inhibit()
        self.latch(finding)  # first: the procedures that it ends report this cause
        if self.procedures.rank is Priority.ARM or not self.torque.energising:
            self.procedures.abandon()
        if self.procedures.rank is None:
            self.torque.end_damping()
        self.executor.idle()
        self.hardware.clear()
        self.hardware.hold(False)
        self.hardware.quiet_until = now + QUIET
        self.change(RobotEvent.INHIBIT, now, stop="inhibit")

    @property
    def state(self) -> RobotState:
        """State of the robot and its bus."""
        return self.condition.state

    @property
    def torque_on(self) -> bool:
        """True while torque of this daemon is on, or read back on from a servo that still replies."""
        return self.torque.armed or self.torque.energising or self.inherited

    @property
    def torque_known(self) -> NDArray[np.int8]:
        """Torque (n,) as read back: 1 on, 0 off; -1 never read, or of a servo without a fresh reading."""
        return np.where(self.measured.age <= GONE, self.hardware.slow.torque, np.int8(-1))

    @property
    def inherited(self) -> bool:
        """True for torque read back on that this daemon did not switch on, or could not switch off."""
        if self.torque.armed or self.torque.energising:
            return False
        return bool((self.torque_known == 1).any())

    @property
    def energised(self) -> bool:
        """True if torque may be on: it is on, or a device on an open bus has not reported it yet."""
        return self.torque_on or bool((self.hardware.slow.torque[self.hardware.open] != 0).any())

    @property
    def torque_off(self) -> bool | None:
        """True if torque is read back off everywhere; False: on somewhere; None: unknown of a joint."""
        torque = self.hardware.slow.torque
        if self.torque.energising or bool((torque == 1).any()):
            return False
        return True if self.mode is not Mode.SIM and bool((torque == 0).all()) else None

    def close(self) -> None:
        """Close the ports, and end the front."""
        self.say.event("info", EventCode.END, f"torque {_torque_text(self.torque_off)}")
        self.publisher.publish(self.clock.now())
        self.hardware.access(read=False, write=False)
        self.link.close()

    # ------------------------------------------------------------------------------- judging

    def snapshot(self, client: int, now: float) -> gate.GateSnapshot:
        """Collect the values that the gate needs, as of `now` (s)."""
        live = self.mode is Mode.LIVE
        target = self.measured if live else self.simulated
        still = np.zeros(len(self.joints))
        reference = self.executor.reference or Reference(target.position, still, still)
        slow = self.hardware.slow
        return gate.GateSnapshot(
            now=now,
            mode=self.mode,
            state=self.state,
            motion=self.executor.motion,
            latched=tuple(self.latches),
            lease_held=self.lease.held_by(client, now),
            mismatches=tuple(self.identity.troubles),
            calibrated=np.array(self.joints.calibrated),
            age=now - target.time + target.age,
            latency=self.health.latency(now),
            latency_p95=self.health.latency_p95(now),
            reference=reference,
            busy=self.submissions.busy,
            bars=self.parts.guard.bars,
            holding=self.parts.guard.holding(self.missed_in_a_row if live else 0, self.period),
            unreachable=self.unreachable,
            condition=JointCondition(
                slow.temperature,
                slow.voltage,
                now - slow.health_time,
                self.parts.ratings,
                self.joints.transmission_groups,
            ),
        )

    def may_arm(self, client: int, now: float) -> Verdict:
        """Judge the request Arm: LEASE_MISSING to LATENCY_BLOCK."""
        verdict = admission.arming(self.snapshot(client, now), self.parts.thresholds)
        if self.mode is Mode.LIVE and not self.hardware.connected:
            finding = Finding(ReasonCode.HW_DISCONNECTED, message="not every bus is open and identified")
            verdict = replace(verdict, refusals=(*verdict.refusals, finding))
        return verdict

    def _report_simulation_reset(self) -> None:
        """Report that the simulation became non-finite and was reset; its motion ends."""
        self._resets = self.twin.resets
        message = "the simulation broke down; it is back where it was sound last: check the model"
        finding = Finding(ReasonCode.INTERNAL, value=float(self._resets), message=message)
        self.say.event("error", ReasonCode.INTERNAL, message, (finding,))
        if self.mode is not Mode.LIVE and self.executor.motion is not Motion.IDLE:
            self.executor.stop("aborted", (finding,))

    def _observe(self, now: float, read: float) -> None:
        """Process the result of the exchange: devices, health, outcomes. `read`: s, end of the exchange."""
        if self.hardware.clamped is not None:
            error = self.hardware.clamped
            self.fail(Finding(ReasonCode.WIRE_CLAMP, value=float(error.value), message=str(error)), now)
        self.identity.watch(now)
        if self.measured.heard.any():
            self.health.hop("state", read - self.measured.time, now)
            self.health.hop("twin", self.clock.now() - read, now)
        self.health.update(self.measured, self.hardware, now, live=self.mode is not Mode.SIM)
        if self.twin.resets != self._resets:
            self._report_simulation_reset()
        self.executor.observe(self.measured if self.mode is Mode.LIVE else self.simulated)
        self.submissions.report(now)
        self.stops.answer()

    def _follow(self, goal: Floats | None, before: JointState, at: float) -> None:
        """Trace the last command: `goal` left at time `at` (s); `before` is the joint state before it."""
        live = self.mode is Mode.LIVE
        if goal is None:
            self.way.silence()
        else:
            if self.executor.motion is not Motion.STREAMING:
                self.way.end(STREAM)
            self.way.write(goal, at, before)
        if live:
            self.way.look(self.measured, self.measured.time)
        else:
            self.way.look(self.simulated, self.clock.now())
        for alert in self.health.alerts():
            self.say.slow(alert)


def _torque_text(off: bool | None) -> str:
    return {None: "unknown: not every servo has reported", True: "is off", False: "is left on"}[off]
