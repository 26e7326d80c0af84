"""Reactions of the loop to the guard's decision: report, latch, hold, lower, inhibit. Loop's process."""

from __future__ import annotations

from dataclasses import replace
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np

from twind.loop.procedures import damping, torque_release
from twind.loop.procedures.procedure_runner import Priority
from twind.loop.tick.blocking_contacts import with_contact
from twind.robot.arrays import Floats, spread_over_groups
from twind.robot.event_codes import EventCode
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Mode, Motion
from twind.robot.trajectory import Reference
from twind.safety.guard_types import MOVING, GuardDecision, Reaction
from twind.safety.state_machine import RobotEvent

if TYPE_CHECKING:
    from twind.loop.tick.control_loop import Loop


def react(loop: Loop, decision: GuardDecision, reference: Reference | None, now: float) -> Floats | None:
    """Carry out the decision; return the goal (n,) that may be written, rad, or None.

    A refused goal is replaced by the last goal.
    """
    if decision.findings or loop.parts.guard.bars:
        _report_decision(loop, decision)
    if decision.latches:
        loop.change(RobotEvent.FAULT, now)
    for bus in decision.gone:
        loop.hardware.give_up(bus, "requests did not reach the devices: emptied, opened anew")
    # After FAULT: the events of the reaction then keep the latched state.
    if decision.reaction >= Reaction.HOLD:
        _act(loop, decision, now)
    _slow(loop, decision)
    if loop.torque.inhibited or reference is None:
        return None
    if decision.goal_refused:
        if loop.written is not None:
            loop.executor.begin(loop.written)
        return loop.written
    return reference.position


def _report_decision(loop: Loop, decision: GuardDecision) -> None:
    """Report each code once, latch faults, and mark joints of servos that restarted or raised an alert."""
    stop = decision.reaction.name.lower() if decision.reaction else ""
    for code, findings in groupby(decision.findings, key=lambda finding: finding.code):
        same = tuple(with_contact(loop, finding) for finding in findings)
        loop.say.event("warning", code, same[0].message, same, stop=stop)
        if decision.latches:
            loop.latch(_of_many(same))
    reported = (
        *decision.findings,
        *loop.parts.guard.bars,
    )  # a second restart within a second is not reported
    if restarted := [finding for finding in reported if finding.code is ReasonCode.SERVO_REBOOTED]:
        loop.identity.restarted(restarted)
    loop.identity.verified.mar([finding for finding in reported if finding.code is ReasonCode.SERVO_ALERT])


def _act(loop: Loop, decision: GuardDecision, now: float) -> None:
    """Apply the reaction ladder: a harder reaction takes over from a softer one, never the reverse."""
    causes = decision.causes
    if decision.reaction >= Reaction.INHIBIT:
        loop.inhibit(decision.findings[0], now)
    elif loop.torque.inhibited:
        return  # no softer reaction ends it: torque stays until an operator switches it off
    elif decision.reaction >= Reaction.SETTLE and loop.torque.armed:
        if decision.reaction >= Reaction.DAMP:
            damping.demand(loop, causes, now)  # a motion to the rest pose ends by it
        loop.procedures.own(Priority.FAULT, lambda: torque_release.fault(loop, now, causes))
    elif decision.here and loop.procedures.rank is None:
        target = loop.measured if loop.mode is Mode.LIVE else loop.simulated
        loop.executor.give_in(_all_of(loop, decision.here), loop.hardware.reachable(target.position), causes)
    elif loop.executor.motion is not Motion.HOLDING:
        loop.executor.stop("aborted", causes)


def _all_of(loop: Loop, joints: tuple[int, ...]) -> list[int]:
    """Return these joints and all joints that the same motors turn, whose goals would push the motors on."""
    named = np.zeros(len(loop.joints), np.bool_)
    named[list(joints)] = True
    return np.flatnonzero(spread_over_groups(named, loop.joints.transmission_groups)).tolist()


def _slow(loop: Loop, decision: GuardDecision) -> None:
    """Set the pace of motions. The motion to the rest pose is a stop and is never slowed."""
    before = loop.executor.pace
    loop.executor.pace = decision.pace if loop.procedures.rank is None else 1.0
    loop.executor.slowed_by = decision.slowing
    if loop.executor.pace < 1.0 and before == 1.0 and loop.executor.motion in MOVING:
        because = ", ".join(decision.slowing)
        loop.say.event("info", EventCode.PACE, f"the motion is slowed to {loop.executor.pace:.0%}: {because}")


def _of_many(findings: tuple[Finding, ...]) -> Finding:
    """Return one finding for all of a code: the first, with the number of further joints."""
    first = findings[0]
    others = {finding.joint for finding in findings} - {None, first.joint}
    return replace(first, message=f"{first.message} (and {len(others)} more joints)") if others else first
