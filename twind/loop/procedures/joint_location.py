"""Turns of joints that an operator states to stand at given angles. Loop's process.

A joint with a travel of more than a turn may stand where its count fits several of them. Torque is off, and
the count within a turn must agree with the stated angle.
"""

from __future__ import annotations

from math import isnan

from twind import link
from twind.loop.ipc.call_outcome import CallFailure, CallOutcome, CallRefusal, CallReply
from twind.loop.procedures.homing_request import place_on_bus
from twind.loop.procedures.joint_verification import JointVerificationState
from twind.loop.procedures.procedure_context import ProcedureContext
from twind.loop.procedures.procedure_runner import Procedure
from twind.loop.procedures.torque_readback import torque_possible
from twind.robot.event_codes import EventCode
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import RobotState
from twind.safety.lease import Lease
from twind.safety.multiturn import STATED_NEAR, StatedPlace

PATIENCE = 2.0  # s until readings have chosen the turns


class JointLocation:
    """Calls `LocateJoints`."""

    def __init__(self, context: ProcedureContext, lease: Lease, verified: JointVerificationState) -> None:
        self._context = context
        self._lease = lease
        self._verified = verified

    def ask(self, command: link.LocateJoints, now: float) -> None:
        """Begin to choose the turns, or reply with the reason why not."""
        context = self._context
        if (denied := self._denied(command, now)) is not None:
            context.reports.answer(command, denied)
            return

        def answer(outcome: CallOutcome | None) -> None:
            self._verified.withdraw(command.joints)
            assert outcome is not None  # `_locate` always returns one
            context.reports.answer(command, outcome)

        context.procedures.beside(self._locate(command), answer)

    def _denied(self, command: link.LocateJoints, now: float) -> CallOutcome | None:
        """Return why nothing may be located now; None: it may."""
        context = self._context
        if not self._lease.renew(command.client, now):
            message = "this connection does not hold the lease"
            return CallRefusal((Finding(ReasonCode.LEASE_MISSING, message=message),))
        state = context.condition.state
        if state is not RobotState.CALIBRATING or torque_possible(context):
            torque = ", torque on or not read" if torque_possible(context) else ""
            allowed = [f"{RobotState.CALIBRATING.value}, torque off"]
            return CallFailure("WrongState", {"state": f"{state.value}{torque}", "allowed": allowed})
        missing = [joint for joint in command.joints if not context.robot.joints.calibrated[joint]]
        message = "no measured zero; calibrate this joint"
        found = [Finding(ReasonCode.CALIB_MISSING, joint, message=message) for joint in missing]
        return CallRefusal(found) if found else None

    def _locate(self, command: link.LocateJoints) -> Procedure:
        """Let the places choose the turns; all must agree with the readings."""
        verified = self._verified
        joints = list(command.joints)
        places = [self._place(command, *stated) for stated in zip(joints, command.positions, strict=True)]
        found = [verified.locate(*each) for each in zip(joints, places, strict=True)]
        against = [each for each in found if each is not None]
        if against:
            return CallRefusal(against)
        now = yield
        deadline = now + PATIENCE
        while not verified.turn_known[joints].all() and now < deadline:
            if (left := verified.refused_turns(joints)) and not verified.waiting(joints):
                return CallRefusal(left)
            now = yield
        if not verified.turn_known[joints].all():
            message = "its turn is still unknown: it does not answer, or not as it was calibrated"
            late = [joint for joint in joints if not verified.turn_known[joint]]
            return CallRefusal([Finding(ReasonCode.CALIB_MISMATCH, each, message=message) for each in late])
        context = self._context
        names = ", ".join(context.robot.joints.names[joint] for joint in joints)
        message = f"{command.holder}: the turn of {names} is that of a stated pose"
        context.reports.event("info", EventCode.HOMING, message)
        stands = context.robot.measured.position[joints].tolist()
        return CallReply({"positions": [None if isnan(each) else each for each in stands]})

    def _place(self, command: link.LocateJoints, joint: int, position: float) -> StatedPlace:
        """Return the place that the angle (rad) of an actuator means."""
        _, row, bus = place_on_bus(self._context, joint)
        whole = self._context.robot.bound.file.joints[joint].type.ticks_per_turn
        count = round(bus.zero[row] + position / bus.scale[row])
        return StatedPlace(count, whole // STATED_NEAR, command.holder)
