"""The state `calibrating`: which lease began it, and when it ends by itself.

In this state arming is refused, the mode stays, and EEPROM may be written. It ends with its lease.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from twind import link
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Mode, RobotState
from twind.safety.state_machine import TABLE, RobotEvent

if TYPE_CHECKING:
    from twind.loop.tick.control_loop import Loop


class CalibratingState:
    """Begin and end of the state; `end_if_due` runs once per tick."""

    def __init__(self, loop: Loop) -> None:
        self._loop = loop
        self._epoch = -1  # of the lease under which the state began

    @property
    def on(self) -> bool:
        """The robot is being calibrated now."""
        return self._loop.state is RobotState.CALIBRATING

    def ask(self, command: link.Calibrate, now: float) -> None:
        """Begin or end calibrating; a request for the present state is no error."""
        loop = self._loop
        if not loop.lease.renew(command.client, now):
            finding = Finding(ReasonCode.LEASE_MISSING, message="this connection does not hold the lease")
            loop.say.refuse(command, (finding,))
            return
        if command.on != self.on and not self._change(command, now):
            return
        loop.say.reply(command, state=loop.state.value)

    def _change(self, command: link.Calibrate, now: float) -> bool:
        """Change the state; False after an error reply."""
        loop = self._loop
        if loop.procedures.rank is not None:
            loop.say.error(command, "Busy", what=loop.procedures.rank.name.lower())
            return False
        if not command.on:
            loop.change(RobotEvent.CALIBRATED, now)
            return True
        state = loop.state.value
        allowed = list(TABLE[RobotEvent.CALIBRATE])
        latched = ", ".join(loop.latches)
        if loop.mode is Mode.SIM:
            loop.say.error(command, "WrongState", state="mode sim", allowed=["mode mirror", "mode live"])
        elif loop.state not in allowed:
            loop.say.error(command, "WrongState", state=state, allowed=allowed)
        elif latched or loop.condition.latched:
            loop.say.error(command, "WrongState", state=f"{state}, latched: {latched}", allowed=["reset"])
        elif loop.torque_on:
            loop.say.error(command, "WrongState", state=f"{state}, torque on", allowed=["disarmed"])
        else:
            self._epoch = loop.lease.epoch
            loop.change(RobotEvent.CALIBRATE, now)
            return True
        return False

    def end_if_due(self, now: float) -> None:
        """End the state when its lease lapsed or changed, or a port was lost, after a running procedure."""
        loop = self._loop
        if not self.on or loop.procedures.rank is not None:
            return
        if any(port.reader is None for port in loop.hardware.ports):
            loop.change(RobotEvent.PORT_LOST, now)
        elif not loop.lease.holds(now) or loop.lease.epoch != self._epoch:
            loop.say.event("warning", ReasonCode.LEASE_LOST, "the lease is gone: the calibration ends")
            loop.change(RobotEvent.CALIBRATED, now)
            loop.identity.settle_state(now)

    def may_keep(self, command: link.WriteRegister, kept: bool, now: float) -> bool:
        """Check whether a register that survives power-off may be written; False after an error reply."""
        loop = self._loop
        if not kept or (self.on and loop.lease.renew(command.client, now)):
            return True
        if not self.on:
            self.refuse(command)
        else:
            message = "another client calibrates: only the lease holder may write EEPROM"
            loop.say.refuse(command, (Finding(ReasonCode.LEASE_MISSING, message=message),))
        return False

    def refuse(self, command: link.WriteRegister) -> None:
        """Refuse a write to EEPROM outside of the state `calibrating`."""
        state = f"{self._loop.state.value}, and {command.name} of id {command.id} is EEPROM"
        self._loop.say.error(command, "WrongState", state=state, allowed=[RobotState.CALIBRATING.value])
