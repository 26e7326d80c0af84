"""What the loop does about the guard's judgement: tell, latch, hold, lower, fall silent. Loop's process."""

from __future__ import annotations

from dataclasses import replace
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np

from twind.loop import damping, torque_release
from twind.loop.blocking_contacts import with_contact
from twind.loop.procedures import Priority
from twind.robot.arrays import Floats, spread_over_groups
from twind.robot.event_codes import EventCode
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Mode, Motion
from twind.robot.trajectory import Reference
from twind.safety.guard_types import MOVING, GuardDecision, Reaction
from twind.safety.state_machine import RobotEvent

if TYPE_CHECKING:
    from twind.loop.tick import Loop


def react(loop: Loop, judgement: GuardDecision, reference: Reference | None, now: float) -> Floats | None:
    """Do what the guard says; what may be written. A goal that may not leave becomes the last goal again."""
    if judgement.findings or loop.parts.guard.bars:
        _report_decision(loop, judgement)
    if judgement.latches:
        loop.change(RobotEvent.FAULT, now)
    for bus in judgement.gone:
        loop.hardware.give_up(bus, "nobody heard us there: emptied, opened anew")
    if judgement.reaction >= Reaction.HOLD:
        _act(loop, judgement, now)
    _slow(loop, judgement)
    if loop.inhibited or reference is None:
        return None
    if judgement.goal_refused:
        if loop.written is not None:
            loop.executor.begin(loop.written)
        return loop.written
    return reference.position


def _report_decision(loop: Loop, judgement: GuardDecision) -> None:
    """News of each code once, latches, and who began anew."""
    stop = judgement.reaction.name.lower() if judgement.reaction else ""
    for code, findings in groupby(judgement.findings, key=lambda finding: finding.code):
        same = tuple(with_contact(loop, finding) for finding in findings)
        loop.say.event("warning", code, same[0].message, same, stop=stop)
        if judgement.latches:
            loop.latch(_of_many(same))
    told = (*judgement.findings, *loop.parts.guard.bars)  # a second restart within a second is not told
    if restarted := [finding for finding in told if finding.code is ReasonCode.SERVO_REBOOTED]:
        loop.identity.restarted(restarted)
    loop.identity.verified.mar([finding for finding in told if finding.code is ReasonCode.SERVO_ALERT])


def _act(loop: Loop, judgement: GuardDecision, now: float) -> None:
    """The ladder: a harder reaction takes a softer one over, never the other way."""
    causes = judgement.causes
    if judgement.reaction >= Reaction.INHIBIT:
        loop.inhibit(judgement.findings[0], now)
    elif loop.inhibited:
        return  # nothing softer ends it: torque stays until an operator lets go
    elif judgement.reaction >= Reaction.SETTLE and loop.armed:
        if judgement.reaction >= Reaction.DAMP:
            damping.demand(loop, causes, now)  # a way to the rest pose under way ends by it
        loop.procedures.own(Priority.FAULT, lambda: torque_release.fault(loop, now, causes))
    elif judgement.here and loop.procedures.rank is None:
        target = loop.measured if loop.mode is Mode.LIVE else loop.simulated
        loop.executor.give_in(_all_of(loop, judgement.here), loop.hardware.reachable(target.position), causes)
    elif loop.executor.motion is not Motion.HOLDING:
        loop.executor.stop("aborted", causes)


def _all_of(loop: Loop, joints: tuple[int, ...]) -> list[int]:
    """With those that their motors turn too: as commanded, these would push the motors on."""
    named = np.zeros(len(loop.joints), np.bool_)
    named[list(joints)] = True
    return np.flatnonzero(spread_over_groups(named, loop.joints.transmission_groups)).tolist()


def _slow(loop: Loop, judgement: GuardDecision) -> None:
    """The pace of motions. The way to the rest pose is a stop: never slowed."""
    before = loop.executor.pace
    loop.executor.pace = judgement.pace if loop.procedures.rank is None else 1.0
    if loop.executor.pace < 1.0 and before == 1.0 and loop.executor.motion in MOVING:
        because = f": {judgement.findings[0].code}" if judgement.findings else ""
        loop.say.event("info", EventCode.PACE, f"the motion is slowed to {loop.executor.pace:.0%}{because}")


def _of_many(findings: tuple[Finding, ...]) -> Finding:
    """One finding for all of a code: the first, that says how many joints it speaks for."""
    first = findings[0]
    others = {finding.joint for finding in findings} - {None, first.joint}
    return replace(first, message=f"{first.message} (and {len(others)} more joints)") if others else first
