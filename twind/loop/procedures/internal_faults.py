"""Faults of the daemon itself: hold and latch, or write nothing any more. Loop's process."""

from __future__ import annotations

from twind.loop.procedures.arming import give_up
from twind.loop.procedures.procedure_context import ProcedureContext
from twind.loop.procedures.procedure_runner import Priority
from twind.robot.finding import Finding
from twind.robot.modes import Motion
from twind.safety.state_machine import RobotEvent

QUIET = 0.3  # s without a packet after an inhibit: any packet would feed the servos' watchdogs (0.1 s)


def fail(context: ProcedureContext, finding: Finding) -> None:
    """Handle an internal fault: hold the last goal, latch, report. A robot on its way down goes on."""
    context.reports.event("error", finding.code, finding.message, (finding,), stop="hold")
    context.condition.latch(finding)
    context.condition.change(RobotEvent.FAULT)
    rank = context.procedures.rank
    if rank is None or rank <= Priority.ARM:
        commanded = context.robot.commanded
        if commanded is not None and context.executor.motion is not Motion.IDLE:
            context.executor.begin(commanded)
        if rank is Priority.ARM:
            context.procedures.own(Priority.DISARM, lambda: give_up(context))


def inhibit(context: ProcedureContext, finding: Finding, now: float) -> None:
    """Write nothing until the servos' own watchdogs have ended the motion; torque stays.

    A procedure that lowers the robot ends: to go on would write, to release would drop the robot. Torque
    that is being switched on or off already goes off, without a wait for the watchdogs.
    """
    context.torque.inhibit()
    context.condition.latch(finding)  # first: the procedures that it ends report this cause
    if not context.torque.energising:
        context.procedures.abandon()
        context.hardware.quiet_until = now + QUIET
    if context.procedures.rank is None:
        context.torque.end_damping()
    context.executor.idle()
    context.hardware.clear()
    context.hardware.hold(False)
    context.condition.change(RobotEvent.INHIBIT, stop="inhibit")
    if context.procedures.rank is Priority.ARM:  # it may have switched torque on, which nobody would own
        context.procedures.own(Priority.DISARM, lambda: give_up(context))
