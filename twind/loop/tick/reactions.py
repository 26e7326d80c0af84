"""Reactions of the loop to the guard's decision: report, latch, hold, lower, inhibit. Loop's process."""

from __future__ import annotations

from dataclasses import replace
from itertools import groupby

import numpy as np

from twind.loop.procedures.damping import demand
from twind.loop.procedures.identification import IdentificationState
from twind.loop.procedures.internal_faults import inhibit
from twind.loop.procedures.procedure_context import ProcedureContext
from twind.loop.procedures.procedure_runner import Priority
from twind.loop.procedures.torque_release import TorqueRelease
from twind.loop.tick.contact_explanations import with_contact
from twind.loop.tick.loop_parts import LoopParts
from twind.robot.arrays import Floats, spread_over_groups
from twind.robot.event_codes import EventCode
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Mode, Motion
from twind.robot.trajectory import Reference
from twind.safety.guard_types import MOVING, GuardDecision, Reaction
from twind.safety.state_machine import RobotEvent


class Reactions:
    """Reactions of one loop."""

    def __init__(
        self,
        context: ProcedureContext,
        parts: LoopParts,
        identity: IdentificationState,
        release: TorqueRelease,
    ) -> None:
        self._context = context
        self._guard = parts.guard
        self._twin = parts.twin
        self._identity = identity
        self._release = release
        self._resets = 0  # resets of the simulation reported so far

    def watch_simulation(self) -> None:
        """Report that the simulation became non-finite and was reset; its motion ends."""
        context = self._context
        if self._twin.resets == self._resets:
            return
        self._resets = self._twin.resets
        message = "the simulation broke down; it is back where it was sound last: check the model"
        finding = Finding(ReasonCode.INTERNAL, value=float(self._resets), message=message)
        context.reports.event("error", ReasonCode.INTERNAL, message, (finding,))
        if context.condition.mode is not Mode.LIVE and context.executor.motion is not Motion.IDLE:
            context.executor.stop("aborted", (finding,))

    def react(self, decision: GuardDecision, reference: Reference | None, now: float) -> Floats | None:
        """Carry out the decision; return the goal (n,) that may be written, rad, or None.

        A refused goal is replaced by the last goal.
        """
        context = self._context
        if decision.findings or self._guard.bars:
            self._report_decision(decision)
        if decision.latches:
            context.condition.change(RobotEvent.FAULT)
        for bus in decision.gone:
            context.hardware.give_up(bus, "requests did not reach the devices: emptied, opened anew")
        # After FAULT: the events of the reaction then keep the latched state.
        if decision.reaction >= Reaction.HOLD:
            self._act(decision, now)
        self._slow(decision)
        if context.torque.inhibited or reference is None:
            return None
        if decision.goal_refused:
            if (commanded := context.robot.commanded) is not None:
                context.executor.begin(commanded)
            return context.robot.written
        return reference.position

    def _report_decision(self, decision: GuardDecision) -> None:
        """Report each code once, latch faults, mark joints of servos that restarted or raised an alert."""
        context = self._context
        stop = decision.reaction.name.lower() if decision.reaction else ""
        for code, findings in groupby(decision.findings, key=lambda finding: finding.code):
            same = tuple(with_contact(context, self._twin, finding) for finding in findings)
            context.reports.event("warning", code, same[0].message, same, stop=stop)
            if decision.latches:
                context.condition.latch(_of_many(same))
        reported = (
            *decision.findings,
            *self._guard.bars,
        )  # a second restart within a second is not reported
        if restarted := [finding for finding in reported if finding.code is ReasonCode.SERVO_REBOOTED]:
            self._identity.restarted(restarted)
        self._identity.verified.mar(
            [finding for finding in reported if finding.code is ReasonCode.SERVO_ALERT]
        )

    def _act(self, decision: GuardDecision, now: float) -> None:
        """Apply the reaction ladder: a harder reaction takes over from a softer one, never the reverse."""
        context = self._context
        causes = decision.causes
        if decision.reaction >= Reaction.INHIBIT:
            inhibit(context, decision.findings[0], now)
        elif context.torque.inhibited:
            return  # no softer reaction ends it: torque stays until an operator switches it off
        elif decision.reaction >= Reaction.SETTLE and context.torque.armed:
            if decision.reaction >= Reaction.DAMP:
                demand(context, causes, now)  # a motion to the rest pose ends by it
            context.procedures.own(Priority.FAULT, lambda: self._release.fault(causes))
        elif decision.here and context.procedures.rank is None:
            target = (
                context.robot.measured if context.condition.mode is Mode.LIVE else context.robot.simulated
            )
            context.executor.give_in(
                self._all_of(decision.here), context.hardware.reachable(target.position), causes
            )
        elif context.executor.motion is not Motion.HOLDING:
            context.executor.stop("aborted", causes)

    def _all_of(self, joints: tuple[int, ...]) -> list[int]:
        """Return these joints and all that the same motors turn: their goals would push the motors on."""
        context = self._context
        named = np.zeros(len(context.robot.joints), np.bool_)
        named[list(joints)] = True
        return np.flatnonzero(spread_over_groups(named, context.robot.joints.transmission_groups)).tolist()

    def _slow(self, decision: GuardDecision) -> None:
        """Set the pace of motions and the fence of streams. The motion to the rest pose is never slowed."""
        context = self._context
        free = context.procedures.rank is None
        slower = free and decision.pace < 1.0 and not context.executor.slowed
        context.executor.pace = decision.pace if free else 1.0
        fence = decision.fence if free else None
        if fence is not None and context.robot.compensation is not None:
            fence = context.robot.compensation.fence_of_commands(fence)
        context.executor.fence = fence
        context.executor.slowed_by = decision.slowing
        if slower and context.executor.motion in MOVING:
            because = ", ".join(decision.slowing)
            context.reports.event(
                "info", EventCode.PACE, f"the motion is slowed to {context.executor.pace:.0%}: {because}"
            )


def _of_many(findings: tuple[Finding, ...]) -> Finding:
    """Return one finding for all of a code: the first, with the number of further joints."""
    first = findings[0]
    others = {finding.joint for finding in findings} - {None, first.joint}
    return replace(first, message=f"{first.message} (and {len(others)} more joints)") if others else first
