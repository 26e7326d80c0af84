"""What the guard of every tick is told: the loop's knowledge, gathered. Loop's process; judges nothing."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from twind.robot.arrays import some
from twind.robot.modes import Mode
from twind.robot.state import JointState
from twind.robot.trajectory import Reference
from twind.safety.facts import Facts

if TYPE_CHECKING:
    from twind.loop.tick import Loop


def facts(loop: Loop, reference: Reference | None, target: JointState, now: float) -> Facts:
    """All that one judgement rests on. `target`: whom commands go to; `reference`: what is about to leave."""
    held = loop.lease.holds(now) and loop.lease.epoch == loop.motion_epoch
    readings, slow = loop.hardware.readings, loop.hardware.slow
    return Facts(
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
        watchdog=slow.watchdog,
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
    follow, and the others must not be damped for it (R15). Before torque nobody is anywhere whose turn is not
    known (R14)."""
    if loop.mode is Mode.LIVE and not loop.armed and some(unjudged := loop.identity.verified.unjudged):
        return replace(target, position=np.where(unjudged, np.nan, target.position))
    if not loop.armed or all(port.holding for port in loop.hardware.ports):
        return target
    return replace(target, heard=target.heard & loop.hardware.held)
