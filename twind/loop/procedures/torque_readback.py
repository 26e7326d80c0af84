"""Torque as the servos report it, beside what this daemon has ordered (`torque_state`). Changes nothing."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twind.loop.procedures.procedure_context import ProcedureContext
from twind.robot.arrays import Bools
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Mode

REPLIED = 0.1  # s since the last reading of a servo that replies
GONE = 0.5  # s without a reading after which a servo's torque counts as unknown
LOST = (
    "a bus was lost with torque on, which has not read off since: connect it, then disarm; if it stays away, "
    "restart the daemon"
)


def torque_known(context: ProcedureContext) -> NDArray[np.int8]:
    """Return torque (n,) as read back: 1 on, 0 off; -1 never read, or of a servo without a fresh reading."""
    return np.where(context.robot.measured.age <= GONE, context.hardware.slow.torque, np.int8(-1))


def found_limp(context: ProcedureContext) -> Bools:
    """Return joints (n,) whose torque reads off, and without which the others can be lowered.

    The legs of a robot that stands freely are never among them.
    """
    off: Bools = torque_known(context) == 0
    return off if context.robot.carried else off & ~context.robot.description.ratings.leg


def torque_inherited(context: ProcedureContext) -> bool:
    """True for torque read back on that this daemon did not switch on, or could not switch off."""
    if context.torque.armed or context.torque.energising:
        return False
    return bool((torque_known(context) == 1).any())


def torque_unreported(context: ProcedureContext) -> bool:
    """True where a device replies and its torque is not known, without torque of this daemon.

    A CAN actuator may report it only after an order: a CubeMars, or a Damiao that has lost its master.
    """
    if context.torque.armed or context.torque.energising:
        return False
    hardware = context.hardware
    return bool(((context.robot.measured.age <= REPLIED) & hardware.open & (hardware.slow.torque < 0)).any())


def torque_on(context: ProcedureContext) -> bool:
    """True while torque of this daemon is on, or read back on from a servo that still replies."""
    return context.torque.armed or context.torque.energising or torque_inherited(context)


def torque_reported(context: ProcedureContext) -> bool | None:
    """Return what is said of torque: True: it is on; False: read back off everywhere; None: not known."""
    if torque_on(context):
        return True
    return False if torque_off(context) else None


def torque_possible(context: ProcedureContext) -> bool:
    """True if torque may be on: it is on, or a device on an open bus has not reported it yet."""
    hardware = context.hardware
    return torque_on(context) or bool((hardware.slow.torque[hardware.open] != 0).any())


def torque_off(context: ProcedureContext) -> bool | None:
    """True if torque is read back off everywhere; False: on somewhere; None: unknown of a joint."""
    torque = context.hardware.slow.torque
    if context.torque.energising or bool((torque == 1).any()):
        return False
    return True if context.condition.mode is not Mode.SIM and bool((torque == 0).all()) else None


def torque_denial(context: ProcedureContext) -> Finding | None:
    """Return why torque forbids another mode; None: it is off, or on a closed bus and not of this daemon."""
    if torque_possible(context):
        return Finding(ReasonCode.MODE_DENIES, message="torque is on: disarm first")
    if context.torque.unconfirmed or context.torque.pending_restore:  # no other mode would switch it off
        return Finding(ReasonCode.MODE_DENIES, message=LOST)
    return None
