"""What the guard of every tick is told: the loop's knowledge, gathered. Loop's process; judges nothing."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from twind.robot.arrays import some
from twind.robot.state import JointState
from twind.robot.trajectory import Reference
from twind.safety.guard_types import GuardInput

if TYPE_CHECKING:
    from twind.loop.tick import Loop


def facts(loop: Loop, reference: Reference | None, target: JointState, now: float) -> GuardInput:
    """All that one judgement rests on. `target`: whom commands go to; `reference`: what is about to leave."""
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
        measured=_obeying(loop, target) if np.isfinite(target.age).any() else None,  # nobody was ever heard
        goal=reference,
        previous=loop.written if reference is not None else None,
        lease_ok=held or loop.procedures.rank is not None,
        setpoint_age=loop.executor.setpoint_age(now),
        torque=slow.torque,
        torque_expected=loop.armed,
        torque_settled=loop.procedures.rank is None,
        # Who was left out keeps the watchdog that it was found with.
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


def _obeying(loop: Loop, target: JointState) -> JointState:
    """The same, but that nobody counts as heard who gets no goals: a bus that was lost and is back does not
    follow, nor does who was left out, and the others must not be damped for it (FOLLOW_ERR)."""
    hardware = loop.hardware
    whole = all(port.holding for port in hardware.ports) and not some(hardware.left_out)
    if not loop.armed or whole:
        return target
    return replace(target, heard=target.heard & hardware.energised_joints)
