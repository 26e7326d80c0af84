"""Conditions of an end-stop search that the registers of the servos tell: torque, watchdog, errors."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from twind.loop.procedures.homing_restore import EndstopSearchRecord
from twind.loop.procedures.procedure_context import ProcedureContext
from twind.robot.arrays import some
from twind.robot.finding import Finding, ReasonCode
from twind_drivers.bus import TRIPPED


def servo_findings(context: ProcedureContext, pending: EndstopSearchRecord) -> Iterator[Finding]:
    """Yield what ends the search.

    Torque of another joint; of its own joint, once its registers were read since torque came on:
    torque that went off, a watchdog that tripped or differs, a hardware error.
    """
    joint = pending.request.joint
    slow = context.hardware.slow
    on = slow.torque == 1
    on[joint] = False
    if some(on):
        other = int(np.argmax(on))
        yield Finding(ReasonCode.TORQUE_MISMATCH, other, value=1.0, bound=0.0, message="its torque is on")
    if pending.powered is None or not slow.status_time[joint] > pending.powered:
        return
    if slow.torque[joint] != 1:
        value = float(slow.torque[joint])
        yield Finding(ReasonCode.TORQUE_MISMATCH, joint, value=value, bound=1.0, message="torque went off")
    if slow.watchdog[joint] == TRIPPED:
        message = "its watchdog tripped: no request on its bus for too long"
        yield Finding(ReasonCode.WATCHDOG_TRIPPED, joint, value=float(TRIPPED), message=message)
    elif (watchdog := float(slow.watchdog[joint])) != pending.watchdog:
        message = "its watchdog differs from the one set: nothing would stop it if the daemon died"
        yield Finding(
            ReasonCode.DEVICE_MISMATCH, joint, value=watchdog, bound=pending.watchdog, message=message
        )
    if slow.fault[joint] > 0:
        value = float(slow.fault[joint])
        yield Finding(ReasonCode.SERVO_ALERT, joint, value=value, bound=0.0, message="hardware error")
