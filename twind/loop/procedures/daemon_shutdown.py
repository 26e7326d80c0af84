"""End of the daemon on SIGTERM: its torque goes off, also on buses that were lost and come back.

A robot that this daemon holds is lowered. Torque off that was ordered before is only sent again.
"""

from __future__ import annotations

from twind.loop.procedures.homing_procedure import HomingProcedure
from twind.loop.procedures.procedure_context import ProcedureContext
from twind.loop.procedures.procedure_runner import Procedure, Steps
from twind.loop.procedures.torque_readback import (
    torque_inherited,
    torque_off,
    torque_on,
    torque_possible,
    torque_unreported,
)
from twind.loop.procedures.torque_release import TorqueRelease
from twind.loop.procedures.torque_state import TorqueState
from twind.loop.procedures.torque_switching import joint_names, retry_torque_off
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Mode
from twind.safety.state_machine import RobotEvent

AWAITED = 1.5  # s that an ending daemon waits for a lost bus with torque that is to go off
WHY = Finding(ReasonCode.NOT_ARMED, message="the daemon ends: the robot is lowered")


def shutdown(
    context: ProcedureContext,
    release: TorqueRelease,
    homing: HomingProcedure,
    now: float,
    *,
    releasing: bool = False,
) -> Procedure:
    """Lower the robot if this daemon has torque on, then end; `now`: s.

    Torque that was found on, or may not be written any more, stays as it is, unless it was going off
    already (`releasing`: this ends the procedure that did so), an end-stop search had it, or a stop is
    latched. A lost bus is waited for, `AWAITED` s before the robot is lowered and after it.
    """
    torque = context.torque
    until = now + AWAITED
    lowers = not (_is_sent(torque) or torque.energising)
    while lowers and _is_due(context) and not context.hardware.connected and now < until:
        now = yield
    if releasing or torque.energising or not torque.inhibited:
        mine = torque.armed or torque.energising or (_is_due(context) and torque_on(context))
        if (releasing or mine) and not _is_sent(torque):
            context.condition.change_if(RobotEvent.SETTLE)
            yield from release.release_reported(WHY)
            until = context.clock.now() + AWAITED
        yield from _release_returned(context, until)
        context.condition.change_if(RobotEvent.SETTLED)
    until = context.clock.now() + AWAITED
    while homing.unrestored is not None and context.clock.now() < until:
        yield  # the servo of an end-stop search is restored
    homing.report_pending_restore()
    context.condition.finished = True
    return None


def _is_sent(torque: TorqueState) -> bool:
    """Check whether torque off was ordered and nothing is held since: no joint is driven any more."""
    ordered = torque.unconfirmed or torque.stop_level == "cut"
    return ordered and not (torque.armed or torque.energising)


def _is_due(context: ProcedureContext) -> bool:
    """Check whether torque may be on that is to go off: of this daemon, or after a latched stop."""
    torque = context.torque
    due = torque.unconfirmed or torque.pending_restore or torque.stop_level is not None
    return due and context.condition.mode is Mode.LIVE and not torque_off(context)


def _release_returned(context: ProcedureContext, until: float) -> Steps:
    """Switch torque that is due off wherever it reads on or is not reported, at least once.

    Wait until `until` (s) for the rest, then report what may be on.
    """
    over = sent = False
    while _is_due(context) and not over:
        # in the end also where a bus is open and its devices are not identified yet
        last = context.clock.now() >= until and not sent and torque_possible(context)
        if torque_inherited(context) or torque_unreported(context) or last:
            yield from retry_torque_off(context)
            sent = True
        over = context.clock.now() >= until
        if not over:
            yield
    if _is_due(context):
        joints = joint_names(context, context.hardware.slow.torque != 0)
        message = f"the daemon ends, and torque of {joints} may be on: support it, switch the power off"
        context.reports.event("error", ReasonCode.TORQUE_MISMATCH, message)
