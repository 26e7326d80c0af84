"""Torque release: disarm, fault, e-stop; the end of the daemon is in `daemon_shutdown`.

Each lowers the robot to its rest pose where it can be held, then switches torque off, twice, and reads it
back. Only an explicit cut skips the motion. A motion that does not end is damped (`damping`) before torque
goes off. A procedure reports torque as read back; what could not be read back is reported as unknown.
"""

from __future__ import annotations

from types import MappingProxyType

from twind.loop.ipc.call_outcome import CallFailure, CallOutcome, CallReply
from twind.loop.procedures.damping import damp
from twind.loop.procedures.internal_faults import fail
from twind.loop.procedures.joint_verification import JointVerificationState
from twind.loop.procedures.lowering import USUAL, SettleProfile, lower
from twind.loop.procedures.procedure_context import ProcedureContext
from twind.loop.procedures.procedure_runner import Priority, Procedure, Steps
from twind.loop.procedures.torque_readback import torque_off, torque_on, torque_possible, torque_reported
from twind.loop.procedures.torque_switching import error_text, say_unconfirmed, switch_torque_off
from twind.loop.procedures.torque_takeover import take_over
from twind.loop.process.service_notify import Notifier
from twind.robot.fall_settings import FallReaction
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Mode
from twind.robot.recovery_steps import torque_text
from twind.safety.state_machine import RobotEvent
from twind.twin.twin import Twin
from twind_drivers.bus import BusError

FOLD = 0.05  # s for the motion of a falling robot to its pose: the limits alone say how long it takes
STOPS = MappingProxyType({"settle": Priority.ESTOP, "cut": Priority.CUT})  # by level


class TorqueRelease:
    """Procedures that end without torque. One owns the torque at a time; a more urgent one takes over."""

    def __init__(
        self, context: ProcedureContext, verified: JointVerificationState, notifier: Notifier, twin: Twin
    ) -> None:
        self._context = context
        self._verified = verified
        self._notifier = notifier
        self._twin = twin

    # ------------------------------------------------------------------------------- what every one does

    def release(self, why: Finding, profile: SettleProfile = USUAL) -> Steps:
        """Lower the robot to the rest pose if it can be held, then switch torque off and read it back.

        Raises BusError. A motion under way ends as aborted, for the reason `why`. A robot that does not come
        to rest is damped. With `profile.whole` torque stays on where not every device took the goals over;
        BusError names the devices.
        """
        context = self._context
        try:
            context.executor.stop("aborted", (why,))
            # a procedure that ends here may have begun to restore the servos' stiffness
            context.hardware.clear()
            yield from self._bring_down(profile)
        except BusError as error:
            if profile.whole and not context.torque.armed:
                raise
            message = f"the way to the rest pose was cut short: {error_text(context, error)}"
            context.reports.event("error", ReasonCode.BUS_ERRORS, message)
        except Exception as error:  # torque off does not depend on the way
            if profile.whole and not context.torque.armed:
                raise
            yield from self._damp_after(error)
        # Whatever failed above, torque off is still sent: an error on the way must not leave torque on.
        yield from switch_torque_off(context)

    def _bring_down(self, profile: SettleProfile) -> Steps:
        """Take the robot over, lower it, and damp it where it does not come to rest. Raises BusError."""
        context = self._context
        if context.torque.inhibited or context.torque.stop_level == "cut":
            return  # after a cut nothing is driven until a reset, whoever switches torque off
        if not (yield from take_over(context, lambda: self._verified.unjudged, profile.whole)):
            return
        if not (yield from lower(context, profile, self._notifier.extend)):
            yield from damp(context)

    def _damp_after(self, error: Exception) -> Steps:
        """Report an internal fault on the way to the rest pose; damp a robot that may be damped."""
        context = self._context
        fail(context, Finding(ReasonCode.INTERNAL, message=repr(error)))
        if context.torque.inhibited or not torque_on(context):
            return
        try:
            yield from damp(context)
        except Exception as again:  # noqa: BLE001 - torque off does not depend on damping either
            fail(context, Finding(ReasonCode.INTERNAL, message=repr(again)))

    def release_reported(self, why: Finding, profile: SettleProfile = USUAL) -> Steps:
        """Release; report what could not be read back off."""
        try:
            yield from self.release(why, profile)
        except BusError as error:
            say_unconfirmed(self._context, error)

    # ------------------------------------------------------------------------------- disarm, fault

    def disarm(self) -> Procedure:
        """Lower the robot, then switch torque off. Its outcome waits until torque is read back off."""
        context = self._context
        if not torque_possible(context):
            return self._disarmed()
        context.condition.change_if(RobotEvent.SETTLE)
        failed = None
        try:
            yield from self.release(Finding(ReasonCode.NOT_ARMED, message="the robot was disarmed"))
        except BusError as error:  # `inherited` and `torque` report the devices that are still on
            torque = torque_text(torque_reported(context))
            if torque_on(context):
                torque += ": `twindctl disarm` again, or switch the power off"
            message = f"torque off is not confirmed: {error_text(context, error)}; {torque}"
            failed = CallFailure("BusFailed", {"bus": "", "message": message})
        context.condition.change_if(RobotEvent.SETTLED)
        return failed or self._disarmed()

    def _disarmed(self) -> CallOutcome:
        """Return the outcome of a disarm: success, unless torque on a bus that is closed is not known."""
        context = self._context
        closed = [port for port in context.hardware.ports if port.reader is None]
        if context.condition.mode is Mode.LIVE and closed:
            trouble = closed[0].trouble or "the bus is not open"
            message = f"{trouble}; whether torque is on there is not known"
            return CallFailure("BusFailed", {"bus": closed[0].name, "message": message})
        return CallReply({"state": context.condition.state.value})

    def fault(self, why: tuple[Finding, ...] = ()) -> Procedure:
        """Settle or damp a robot that cannot be held, then release it. Latches stay until a reset."""
        condition = self._context.condition
        unknown = Finding(ReasonCode.FAULT_LATCHED, message="a fault")
        latched = next(iter(why or condition.latches.values()), unknown)
        condition.change_if(RobotEvent.SETTLE)
        yield from self.release_reported(latched, self._profile(why))
        condition.change_if(RobotEvent.SETTLED)
        return None

    def _profile(self, why: tuple[Finding, ...]) -> SettleProfile:
        """Return how the robot is lowered for a fault: a falling one may have a pose of its own."""
        if not any(finding.code is ReasonCode.FALLING for finding in why):
            return USUAL
        fall = self._context.robot.bound.file.fall
        if fall is None or fall.reaction is not FallReaction.FOLD:
            return USUAL
        return SettleProfile(way=FOLD, pose=fall.pose)

    # ------------------------------------------------------------------------------- e-stop

    def request_stop(self, level: str, reason: str) -> None:
        """Latch an e-stop for `reason` and begin it, unless a daemon that ends has torque off already."""
        context = self._context
        context.condition.latch(Finding(ReasonCode.ESTOP, message=reason))
        if context.condition.stop_wanted and torque_off(context):
            return  # nothing is left to stop, and the end of the daemon must not be put off for ever
        self.stop(level)

    def stop(self, level: str) -> None:
        """Begin an e-stop, unless one as hard is under way.

        While it is latched, it begins again for every bus that comes back with torque on.
        """
        context = self._context
        context.torque.latch_stop(level)
        rank = STOPS[level]
        if context.procedures.rank is None or context.procedures.rank < rank:
            context.torque.begin_stop()
            context.procedures.own(rank, lambda: self._estop(level))

    def _estop(self, level: str) -> Procedure:
        """Stop, by level. `EStopReplies` replies to the calls: when it has begun, and when it is over."""
        context = self._context
        why = context.condition.latches[ReasonCode.ESTOP]
        context.condition.change(RobotEvent.ESTOP, stop=level)
        if context.condition.mode is not Mode.LIVE or not context.hardware.writers:
            context.executor.stop("aborted", (why,))
            self._twin.halt()
            if context.condition.mode is Mode.LIVE:
                context.torque.defer_release()
            return None
        try:
            if level == "cut":
                try:
                    context.executor.stop("aborted", (why,))
                finally:  # torque goes off before an exception is reported
                    yield from switch_torque_off(context)
            else:
                yield from self.release(why)
        except BusError as error:
            say_unconfirmed(context, error)
        return None
