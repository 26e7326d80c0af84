"""Input of the guard for one tick, collected from the context. Loop's process; judges nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twind.loop.procedures.procedure_context import ProcedureContext
from twind.loop.tick.loop_figures import LoopFigures
from twind.robot.arrays import some
from twind.robot.joint_state import JointState
from twind.robot.trajectory import Reference
from twind.safety.guard_types import GuardInput


def facts(
    context: ProcedureContext,
    figures: LoopFigures,
    reference: Reference | None,
    target: JointState,
    now: float,
    *,
    lease_held: bool,
) -> GuardInput:
    """Return the values of one guard decision.

    `target`: state that follows commands; `reference`: the next goal; `lease_held`: the lease under which the
    motion was accepted is held.
    """
    readings = context.hardware.readings
    slow = context.hardware.slow
    left_out = context.hardware.left_out
    return GuardInput(
        now=now,
        mode=context.condition.mode,
        state=context.condition.state,
        motion=context.executor.motion,
        period=context.robot.period,
        lateness=figures.lateness,
        missed_in_a_row=figures.missed_in_a_row,
        # None before the first reading
        measured=_mask_without_goals(context, target) if _was_read(target) else None,
        goal=reference,
        previous=context.robot.written if reference is not None else None,
        lease_ok=lease_held or context.procedures.rank is not None,
        setpoint_age=context.executor.setpoint_age(now),
        torque=slow.torque,
        torque_expected=context.torque.armed,
        torque_settled=context.procedures.rank is None,
        # a device that was left out keeps the watchdog value that it was found with
        watchdog=np.where(left_out, np.int16(-1), slow.watchdog) if some(left_out) else slow.watchdog,
        status_time=slow.status_time,
        discarded=context.hardware.last_exchange.discarded,
        traffic=context.hardware.last_exchange.traffic,
        alerts=readings.alerts,
        fault=slow.fault,
        tick=slow.tick,
        health_time=slow.health_time,
        temperature=slow.temperature,
        voltage=slow.voltage,
        jumps=readings.jumps,
        leaps=readings.leaps,
        simulated=context.robot.simulated,
        outlook=context.robot.outlook.look(context.executor) if context.robot.outlook is not None else None,
        load=readings.loads(now),
        limp=context.torque.limp if context.torque.partial else None,
        external=None if context.robot.observer is None else context.robot.observer.external,
        suspended=context.clock.suspended(),
    )


def _was_read(state: JointState) -> bool:
    """Check that a joint has been read since the start."""
    return some(state.heard) or bool(np.isfinite(state.age).any())


def _mask_without_goals(context: ProcedureContext, target: JointState) -> JointState:
    """Return `target` with joints that get no goals marked as without a fresh reading.

    A bus that came back after a loss does not follow, nor does a joint that was left out. The others must not
    be damped for it (FOLLOW_ERR).
    """
    hardware = context.hardware
    if not context.torque.armed or hardware.is_whole:
        return target
    return replace(target, heard=target.heard & hardware.energised_joints)
