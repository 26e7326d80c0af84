"""The state `calibrating`: which lease began it, and when it ends by itself.

In this state arming is refused, the mode stays, and EEPROM may be written. It ends with its lease.
"""

from __future__ import annotations

from twind import link
from twind.loop.ipc.call_outcome import CallFailure, CallOutcome, CallRefusal
from twind.loop.procedures.identification import IdentificationState
from twind.loop.procedures.procedure_context import ProcedureContext
from twind.loop.procedures.torque_readback import torque_on
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Mode, RobotState
from twind.safety.lease import Lease
from twind.safety.state_machine import TABLE, RobotEvent


class CalibratingState:
    """Begin and end of the state; `end_if_due` runs once per tick."""

    def __init__(self, context: ProcedureContext, lease: Lease, identity: IdentificationState) -> None:
        self._context = context
        self._lease = lease
        self._identity = identity
        self._epoch: int  # of the lease under which the state was requested last

    @property
    def on(self) -> bool:
        """The robot is being calibrated now."""
        return self._context.condition.state is RobotState.CALIBRATING

    def ask(self, command: link.Calibrate, now: float) -> None:
        """Begin or end calibrating; a request for the present state is no error."""
        context = self._context
        if not self._lease.renew(command.client, now):
            finding = Finding(ReasonCode.LEASE_MISSING, message="this connection does not hold the lease")
            context.reports.refuse(command, (finding,))
            return
        if command.on != self.on and not self._change(command, now):
            return
        if command.on:
            self._epoch = self._lease.epoch
        context.reports.reply(command, state=context.condition.state.value)

    def _change(self, command: link.Calibrate, now: float) -> bool:
        """Change the state; False after an error reply."""
        context = self._context
        if context.procedures.rank is not None:
            context.reports.error(command, "Busy", what=context.procedures.rank.name.lower())
            return False
        if not command.on:
            self._end(now)
            return True
        state = context.condition.state.value
        allowed = list(TABLE[RobotEvent.CALIBRATE])
        latched = ", ".join(context.condition.latches)
        closed = next((port for port in context.hardware.ports if port.reader is None), None)
        if context.condition.mode is Mode.SIM:
            context.reports.error(
                command, "WrongState", state="mode sim", allowed=["mode mirror", "mode live"]
            )
        elif context.condition.state not in allowed:
            context.reports.error(command, "WrongState", state=state, allowed=allowed)
        elif latched or context.condition.latched:
            context.reports.error(
                command, "WrongState", state=f"{state}, latched: {latched}", allowed=["reset"]
            )
        elif torque_on(context):
            context.reports.error(command, "WrongState", state=f"{state}, torque on", allowed=["disarmed"])
        elif closed is not None:  # the state would end at once
            message = closed.trouble or "the bus is not open"
            context.reports.error(command, "BusFailed", bus=closed.name, message=message)
        else:
            context.condition.change(RobotEvent.CALIBRATE)
            return True
        return False

    def end_if_due(self, now: float) -> None:
        """End the state when its lease lapsed or changed, or a port was lost, after a running procedure."""
        context = self._context
        if not self.on or context.procedures.rank is not None:
            return
        if any(port.reader is None for port in context.hardware.ports):
            context.condition.change(RobotEvent.PORT_LOST)
        elif not self._lease.holds(now) or self._lease.epoch != self._epoch:
            context.reports.event("warning", ReasonCode.LEASE_LOST, "the lease is gone: the calibration ends")
            self._end(now)

    def _end(self, now: float) -> None:
        self._context.condition.change(RobotEvent.CALIBRATED)
        self._identity.settle_state(now)

    def refusal_to_keep(self, command: link.WriteRegister, kept: bool, now: float) -> CallOutcome | None:
        """Return why a register that survives power-off may not be written; None: it may."""
        if not kept or (self.on and self._lease.renew(command.client, now)):
            return None
        if not self.on:
            return self.not_calibrating(command)
        message = "another client calibrates: only the lease holder may write EEPROM"
        return CallRefusal((Finding(ReasonCode.LEASE_MISSING, message=message),))

    def not_calibrating(self, command: link.WriteRegister) -> CallFailure:
        """Return the error of a write to EEPROM outside of the state `calibrating`."""
        state = f"{self._context.condition.state.value}, and {command.name} of id {command.id} is EEPROM"
        return CallFailure("WrongState", {"state": state, "allowed": [RobotState.CALIBRATING.value]})
