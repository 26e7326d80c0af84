"""Torque: take-over of goals, torque off with read-back, and its retry.

Torque off that a device did not confirm is pending: it is sent again when the device replies.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import inf

import numpy as np

from twind.loop.bus.bus_wait import all_of
from twind.loop.procedures.procedure_context import ProcedureContext
from twind.loop.procedures.procedure_runner import Procedure, Steps
from twind.robot.arrays import Bools, Floats
from twind.robot.finding import ReasonCode
from twind.safety.guard import GuardThresholds
from twind_drivers.bus import BusError, NoReply

# s that torque off is repeated to devices that do not confirm it; one lost packet must not leave torque on
INSIST = 1.0
EDGE = GuardThresholds().beyond_hard  # rad beyond a hard limit that count as encoder error (OUT_OF_LIMIT)


def beyond_hard_limit(context: ProcedureContext) -> Bools:
    """Return joints (n,) measured beyond a hard limit: no goal may be there, and one inside is a step.

    Joints with unknown position (NaN) are not among them.
    """
    position = context.robot.measured.position
    lower, upper = held_range(context)
    return (position < lower) | (position > upper)


def held_range(context: ProcedureContext) -> tuple[Floats, Floats]:
    """Return the least and the largest measured position (n,), rad, at which a joint may be held."""
    limits = context.robot.limits
    return limits.hard_lower - EDGE, limits.hard_upper + EDGE


def joint_names(context: ProcedureContext, which: Bools) -> str:
    """Return the names of the joints of the mask (n,); of many the first ones."""
    names = [context.robot.joints.names[joint] for joint in np.flatnonzero(which).tolist()]
    more = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return ", ".join(names[:3]) + more


def error_text(context: ProcedureContext, error: Exception) -> str:
    """Return the text of a bus error, with the joints whose devices did not reply."""
    which = joints_of(context, error.port, error.ids) if isinstance(error, NoReply) else np.zeros(0, np.bool_)
    return f"{error} ({joint_names(context, which)})" if which.any() else str(error)


def joints_of(context: ProcedureContext, port: str, ids: Sequence[int]) -> Bools:
    """Return the mask (n,) of the joints of these devices."""
    found = np.zeros(len(context.robot.joints), np.bool_)
    for bus in context.robot.joints.buses:
        if bus.name == port:
            found[bus.joints[np.isin(bus.ids, ids)]] = True
    return found


def say_unconfirmed(context: ProcedureContext, error: BusError) -> None:
    """Report torque off that a device did not confirm."""
    message = f"torque could not be read back off: {error_text(context, error)}"
    context.reports.event("error", ReasonCode.TORQUE_MISMATCH, message)


def take(context: ProcedureContext, held: Floats) -> None:
    """Take over the goals (n,), rad: every open bus holds at `held`, which was written and read back."""
    context.hardware.hold(True)
    context.torque.take_hold(context.hardware.energised_joints)
    context.executor.begin(held)
    context.robot.restart(held)


def switch_torque_off(context: ProcedureContext) -> Steps:
    """Switch torque off and read it back. Raises BusError that names the devices without confirmation.

    `retry_torque_off` sends it again later.
    """
    context.executor.idle()
    context.hardware.clear()
    # Goals stop first, or the next one would follow the cut. The cut goes out with whatever packet is next,
    # before the script below that reads it back.
    context.hardware.hold(False)
    for writer in context.hardware.writers:
        # sent a second time with the next packet of any kind, as a sync write is not acknowledged
        writer.cut()
    context.hardware.quiet_until = -inf  # torque off does not wait for device watchdogs
    # not known to be off until it is read back
    context.torque.begin_release()
    until = context.clock.now() + INSIST
    while True:
        try:
            yield from all_of(context.hardware.torque(False))
        except (BusError, KeyError, ValueError) as error:
            if not context.hardware.writers or not context.clock.now() < until:
                # devices that are still on show it in their registers, and are reported as inherited
                context.torque.leave_unconfirmed()
                if isinstance(error, BusError):
                    raise
                raise BusError(f"torque off failed inside: {error!r}") from None
            yield
        else:
            context.torque.confirm_off()
            return


def retry_torque_off(context: ProcedureContext) -> Procedure:
    """Switch torque off once more after a device that did not confirm it replies and may have torque."""
    context.reports.event(
        "warning", ReasonCode.TORQUE_MISMATCH, "torque was ordered off and may be on: off once more"
    )
    try:
        yield from switch_torque_off(context)
    except BusError as error:
        say_unconfirmed(context, error)
    return None
