"""Input of the guard for one tick, collected from the loop. Loop's process; judges nothing."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from twind.robot.arrays import some
from twind.robot.joint_state import JointState
from twind.robot.trajectory import Reference
from twind.safety.guard_types import GuardInput

if TYPE_CHECKING:
    from twind.loop.tick.control_loop import Loop


def facts(loop: Loop, reference: Reference | None, target: JointState, now: float) -> GuardInput:
    """Return the values of one guard decision.

    `target`: state that follows commands; `reference`: the next goal.
    """
    held = loop.lease.holds(now) and loop.lease.epoch == loop.motion_epoch
    readings = loop.hardware.readings
    slow = loop.hardware.slow
    left_out = loop.hardware.left_out
    return GuardInput(
        now=now,
        mode=loop.mode,
        state=loop.state,
        motion=loop.executor.motion,
        period=loop.period,
        lateness=loop.lateness,
        missed_in_a_row=loop.missed_in_a_row,
        # None before the first reading
        measured=_mask_without_goals(loop, target) if _was_read(target) else None,
        goal=reference,
        previous=loop.written if reference is not None else None,
        lease_ok=held or loop.procedures.rank is not None,
        setpoint_age=loop.executor.setpoint_age(now),
        torque=slow.torque,
        torque_expected=loop.torque.armed,
        torque_settled=loop.procedures.rank is None,
        # a device that was left out keeps the watchdog value that it was found with
        watchdog=np.where(left_out, np.int16(-1), slow.watchdog) if some(left_out) else slow.watchdog,
        status_time=slow.status_time,
        discarded=loop.hardware.discarded,
        traffic=loop.hardware.traffic,
        alerts=readings.alerts,
        fault=slow.fault,
        tick=slow.tick,
        health_time=slow.health_time,
        temperature=slow.temperature,
        voltage=slow.voltage,
        jumps=readings.jumps,
        leaps=readings.leaps,
        simulated=loop.simulated,
        outlook=loop.outlook.look(loop.executor) if loop.outlook is not None else None,
        load=readings.loads(now),
        suspended=loop.clock.suspended(),
    )


def _was_read(state: JointState) -> bool:
    """Check that a joint has been read since the start."""
    return some(state.heard) or bool(np.isfinite(state.age).any())


def _mask_without_goals(loop: Loop, target: JointState) -> JointState:
    """Return `target` with joints that get no goals marked as without a fresh reading.

    A bus that came back after a loss does not follow, nor does a joint that was left out. The others must not
    be damped for it (FOLLOW_ERR).
    """
    hardware = loop.hardware
    if not loop.torque.armed or hardware.is_whole:
        return target
    return replace(target, heard=target.heard & hardware.energised_joints)
