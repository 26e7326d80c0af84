"""The loop: its tick and its state. Runs in the daemon's main process, in one thread.

No asyncio, no files, no logging: reports leave by the link. Time is an argument below `run`.
"""

from __future__ import annotations

from math import floor

import numpy as np

from twind.loop.ipc.responder import Responder
from twind.loop.procedures.command_handlers import CommandHandlers
from twind.loop.procedures.controlled_robot import ControlledRobot, RobotInForce
from twind.loop.procedures.identification import IdentificationState
from twind.loop.procedures.internal_faults import fail, inhibit
from twind.loop.procedures.joint_verification import JointVerificationState
from twind.loop.procedures.mode_entry import ModeEntry
from twind.loop.procedures.procedure_runner import ProcedureRunner
from twind.loop.procedures.robot_condition import RobotCondition
from twind.loop.procedures.supply_control import SupplyControl
from twind.loop.procedures.torque_readback import torque_reported
from twind.loop.procedures.torque_release import TorqueRelease
from twind.loop.procedures.torque_state import TorqueState
from twind.loop.tick.guard_input import facts
from twind.loop.tick.loop_figures import LoopFigures
from twind.loop.tick.loop_parts import LoopParts
from twind.loop.tick.reactions import Reactions
from twind.loop.tick.state_publisher import StatePublisher
from twind.motion.gravity_compensation import GravityCompensation
from twind.motion.limp_joints import LimpJoints
from twind.robot.arrays import Floats
from twind.robot.event_codes import EventCode
from twind.robot.finding import Finding, ReasonCode
from twind.robot.joint_state import JointState
from twind.robot.modes import Mode, Motion
from twind.robot.trajectory import Reference
from twind.telemetry.command_latency import STREAM

PATIENCE = 3  # ticks in a row that may fail with an exception before the daemon ends (INTERNAL)


class Loop:
    """One daemon's loop. Procedures see it as `ProcedureContext`: the first eight attributes."""

    def __init__(self, parts: LoopParts, mode: Mode) -> None:
        self.clock = parts.clock
        self.hardware = parts.hardware
        self.executor = parts.executor
        self.reports = Responder(parts.link, parts.clock)
        self.condition = RobotCondition(mode, self.reports)
        self.procedures = ProcedureRunner(lambda: self.condition.cause)
        simulated = parts.twin.update(None, None, parts.clock.now())
        described = RobotInForce.of(parts.bound, parts.period)
        self.robot = ControlledRobot(described, parts.outlook, simulated, parts.compensation, parts.observer)
        self.torque = TorqueState(len(described.joints))
        self.parts = parts
        self.figures = LoopFigures(parts.period, parts.realtime)
        modes = ModeEntry(self, parts.twin, parts.way)
        verified = JointVerificationState(self, parts.guard)
        release = TorqueRelease(self, verified, parts.notifier, parts.twin)
        self.identity = IdentificationState(self, verified, release, modes)
        self.supply = SupplyControl(self, parts.power, release.request_stop)
        self.commands = CommandHandlers(
            self, parts, self.identity, release, modes, self.figures, lambda: self.troubles
        )
        self.reactions = Reactions(self, parts, self.identity, release)
        self.publisher = StatePublisher(
            self, parts, self.identity, self.commands.reloads, self.figures, self.supply
        )
        modes.enter(mode)

    @property
    def troubles(self) -> list[Finding]:
        """Findings on devices, joints and supply that prevent arming."""
        return [*self.identity.troubles, *self.supply.findings]

    # ------------------------------------------------------------------------------- time

    def run(self, until: float = np.inf) -> None:
        """Tick at absolute deadlines until finished. A missed tick is counted and never caught up."""
        deadline = self.clock.now()
        while not self.condition.finished and deadline < until:
            self.clock.sleep_until(deadline)
            now = self.clock.now()
            self.figures.lateness = now - deadline
            self._attempt(now)
            deadline += self.parts.period
            behind = floor((self.clock.now() - deadline) / self.parts.period) + 1
            missed = max(0, behind)
            deadline += missed * self.parts.period
            self.figures.tick(missed)

    def tick(self, now: float) -> None:
        """Run one period: commands, procedures, gate, exchange, twin, reports."""
        self.supply.serve(now)
        self.commands.serve(now)
        self.procedures.step(now)
        live = self.condition.mode is Mode.LIVE
        target = (
            self.robot.measured if live else self.robot.simulated
        )  # the state that follows commands and is judged
        self.executor.limp = self._limp_joints() if live and self.torque.partial else None
        reference = self.executor.goal(now, self.figures.missed_in_a_row)
        if self.robot.compensation is not None:
            reference = self._compensated(self.robot.compensation, reference)
        goal = self.guard(reference, target, now)
        self.robot.measured = self.hardware.exchange(goal if live and self.torque.armed else None, now)
        if self.robot.observer is not None:
            held = live and self.torque.armed
            followed = self.robot.written if self.torque.soft_since is None else None
            limp = self.torque.limp if held and self.torque.partial else None
            self.robot.observer.update(self.robot.measured, held=held, goal=followed, limp=limp)
        left = goal if self.hardware.left or not live else None
        self.robot.written = self.robot.written if left is None else left
        read = self.clock.now()
        self.robot.simulated = self.parts.twin.update(self.robot.measured, goal, now)
        self._observe(now, read)
        self._follow(left, target, self.hardware.sent if live else read)
        self.publisher.publish(now)

    def _limp_joints(self) -> LimpJoints:
        """Return the limp joints and where a goal for them may be."""
        return LimpJoints(self.torque.limp, self.hardware.reachable(self.robot.measured.position))

    def _compensated(self, against: GravityCompensation, reference: Reference | None) -> Reference | None:
        """Return the goal with its offset against gravity, which fades out while a procedure moves."""
        if reference is None:
            against.reset()
            return None
        robot = self.robot
        held = self.condition.mode is not Mode.LIVE or (
            self.torque.armed and self.torque.soft_since is None and not self.torque.partial
        )
        active = held and self.procedures.rank is None
        return against.compensate(reference, robot.written, robot.limits, robot.period, active=active)

    def _attempt(self, now: float) -> None:
        """Run a tick; hold the last goal after an exception, give up after several in a row (INTERNAL)."""
        try:
            self.tick(now)
        except Exception as error:
            self.figures.failed_in_a_row += 1
            finding = Finding(ReasonCode.INTERNAL, message=repr(error))
            if self.figures.failed_in_a_row >= PATIENCE:
                inhibit(self, finding, now)
                raise
            fail(self, finding)
        else:
            self.figures.failed_in_a_row = 0
            # Only a complete tick feeds the service manager's watchdog: else it restarts the daemon.
            self.parts.notifier.alive(now)
            self.supply.beat()  # without it the supply relay opens

    # ------------------------------------------------------------------------------- the per-tick gate

    def guard(self, reference: Reference | None, target: JointState, now: float) -> Floats | None:
        """Return what may be written this tick: the goal, the last goal again, or nothing (None)."""
        lease = self.parts.lease
        held = lease.holds(now) and lease.epoch == self.commands.submissions.epoch
        given = facts(self, self.figures, reference, target, now, lease_held=held)
        return self.reactions.react(self.parts.guard.judge(given), reference, now)

    # ------------------------------------------------------------------------------- its end

    def close(self) -> None:
        """Close the ports, and end the front."""
        self.reports.event("info", EventCode.END, _torque_text(torque_reported(self), self.condition.mode))
        self.publisher.publish(self.clock.now())
        self.hardware.access(read=False, write=False)
        self.supply.close()
        self.parts.link.close()

    # ------------------------------------------------------------------------------- after the exchange

    def _observe(self, now: float, read: float) -> None:
        """Process the result of the exchange: devices, health, outcomes. `read`: s, end of the exchange."""
        if self.hardware.clamped is not None:
            error = self.hardware.clamped
            fail(self, Finding(ReasonCode.WIRE_CLAMP, value=float(error.value), message=str(error)))
        self.identity.watch(now)
        if self.robot.measured.heard.any():
            self.parts.health.hop("state", read - self.robot.measured.time, now)
            self.parts.health.hop("twin", self.clock.now() - read, now)
        self.parts.health.update(
            self.robot.measured, self.hardware.last_exchange, now, live=self.condition.mode is not Mode.SIM
        )
        self.reactions.watch_simulation()
        live = self.condition.mode is Mode.LIVE
        self.executor.observe(self.robot.measured if live else self.robot.simulated, self.hardware.reachable)
        self.commands.submissions.report(now)
        self.commands.stops.answer()

    def _follow(self, goal: Floats | None, before: JointState, at: float) -> None:
        """Trace the last command: `goal` left at time `at` (s); `before` is the joint state before it."""
        live = self.condition.mode is Mode.LIVE
        if goal is None:
            self.parts.way.silence()
        else:
            if self.executor.motion is not Motion.STREAMING:
                self.parts.way.end(STREAM)
            self.parts.way.write(goal, at, before)
        if live:
            self.parts.way.look(self.robot.measured, self.robot.measured.time)
        else:
            self.parts.way.look(self.robot.simulated, self.clock.now())
        for alert in self.parts.health.alerts():
            self.reports.slow(alert)


def _torque_text(torque_on: bool | None, mode: Mode) -> str:
    if torque_on is None:
        return (
            "mode sim drives no servos"
            if mode is Mode.SIM
            else "torque unknown: not every servo has reported"
        )
    return "torque is left on" if torque_on else "torque is off"
