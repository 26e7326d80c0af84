"""Reload of settings while the daemon runs: checks, and the update of all parts between two ticks.

The front reads the files (`front/reload_queue.py`) and sends the changes. Here they are judged once more and
put in force completely or not at all. Changes of the robot need it at rest: no motion, and in live no torque.
Loop's process.
"""

from __future__ import annotations

import os
from dataclasses import replace
from math import inf
from typing import Any

import numpy as np

from twind import link
from twind.config import hot_changes
from twind.config.hot_keys import of_robot
from twind.loop.procedures.gate_input import GateInput
from twind.loop.procedures.homing_procedure import HomingProcedure
from twind.loop.procedures.procedure_context import ProcedureContext
from twind.loop.procedures.torque_readback import torque_off, torque_possible
from twind.loop.tick.bound_robot import BoundRobot
from twind.loop.tick.loop_parts import LoopParts
from twind.robot.arrays import Bools, Floats
from twind.robot.event_codes import EventCode
from twind.robot.finding import Finding, ReasonCode
from twind.robot.joint_limits import JointLimits
from twind.robot.modes import Mode, Motion
from twind.safety.gate import GateThresholds

PATIENCE = 20.0  # s that reading and checking the files may take, since the last report of its start
FRESH = 0.5  # s: an older reading is not the place of a joint without torque
LISTED = 6  # keys that one line lists


class ReloadCoordinator:
    """State of a reload: the request and the values in force. `wanted` is set by SIGHUP."""

    def __init__(
        self, context: ProcedureContext, parts: LoopParts, gate_input: GateInput, homing: HomingProcedure
    ) -> None:
        self._context = context
        self._parts = parts
        self._gate_input = gate_input
        self._homing = homing
        self.wanted = False
        self.generation = 0  # changes made since the start
        self.result = ""  # result of the last reload for the status line; empty: nothing to report
        self._until = inf  # s, when the front's reply is due; inf: none is

    # ------------------------------------------------------------------------------- requests and replies

    def want(self) -> None:
        """Request a reload; may be called by a signal handler."""
        self.wanted = True

    def serve(self, now: float) -> None:
        """Forward the request of SIGHUP, and fail a reload whose front does not reply.

        Called once per tick.
        """
        if self.wanted:
            self.wanted = False
            if not self._context.condition.stop_wanted:
                self.begin(now)
                self._parts.link.ask_reread()
        if now > self._until:
            self.failed(f"the files were not read within {PATIENCE:g} s; nothing was changed")

    def begin(self, now: float) -> None:
        """Note that the front reads the files.

        Notify the service manager once (sd_notify(3), RELOADING=1).
        """
        if self._until == inf:
            since = self._context.clock.now()
            self._parts.notifier.send(RELOADING="1", MONOTONIC_USEC=f"{since * 1e6:.0f}")
        self._until = now + PATIENCE

    def failed(self, why: str) -> None:
        """Keep the old values in force, and report the reason `why` to all clients."""
        self._context.reports.event("error", EventCode.RELOAD_REFUSED, why)
        self._end(f"the last reload was refused: {why}")

    def front_lost(self) -> None:
        """Fail the reload: the front that read the files is gone."""
        if self._until < inf:
            self.failed("the front was lost while it read the files; reload again")

    def _end(self, result: str) -> None:
        """End a reload with READY=1, also a refused one: the daemon serves on."""
        self.result = result
        self._context.reports.urgent = True
        if self._until < inf:
            self._until = inf
            self._parts.notifier.send(READY="1")

    # ------------------------------------------------------------------------------- put in force

    def adopt(self, command: link.ApplyChanges, briefing: int | None, now: float) -> None:
        """Put changes in force, all or none.

        `briefing`: descriptor for the next front, closed here if refused.
        """
        try:
            kept = self._adopt(command, briefing, now)
        except ValueError as error:  # InvalidInput, or a gain that a driver's field does not hold
            kept = False
            self._refuse(command, (Finding(ReasonCode.CONFIG_REFUSED, message=str(error)),))
        if briefing is not None and not kept:
            os.close(briefing)

    def _adopt(self, command: link.ApplyChanges, briefing: int | None, now: float) -> bool:
        """Put changes in force; True: `briefing` is kept.

        Raises ValueError, InvalidInput without any change.
        """
        context = self._context
        if command.reread and self._until == inf:  # the reload was reported as failed, so nothing may change
            self._refuse(
                command, (Finding(ReasonCode.BUSY, message="the files came too late: reload again"),)
            )
            return False
        if command.generation != self.generation + 1 or briefing is None:
            self._refuse(
                command, (Finding(ReasonCode.BUSY, message="other changes came first: reload again"),)
            )
            return False
        thresholds = thresholds_with(self._gate_input.thresholds, command.changes)
        robot = of_robot(command.changes)
        if robot:
            one = context.robot.bound.with_changes(robot)
            unfit = (
                *self._not_allowed(command, now),
                *self.at_rest(),
                *outside(context, one.binding.limits, now),
            )
            if unfit:
                self._refuse(command, unfit)
                return False
            put_in_force(context, self._parts, one)  # may raise, before it has changed anything
        self._gate_input.thresholds = thresholds
        self._parts.health.warn_above(thresholds.latency_warn)
        self.generation = command.generation
        if robot:
            self._gate_input.judged_since = self.generation
            self._gate_input.gains_tried_by = command.client if command.on_trial else 0
        self._parts.link.set_briefing(briefing)
        self._publish_reload(command)
        return True

    def _not_allowed(self, command: link.ApplyChanges, now: float) -> tuple[Finding, ...]:
        """Return LEASE_MISSING for a client that changes the robot itself, BUSY after another one's trial.

        Empty: it holds the lease. Files, and gains that the front puts back, need none.
        """
        if command.reread or command.client == 0:
            return ()
        if command.client != self._parts.lease.holder_client(now):
            return (Finding(ReasonCode.LEASE_MISSING, message="take the lease first"),)
        return self._gate_input.foreign_gains(command.client)

    def _refuse(self, command: link.ApplyChanges, findings: tuple[Finding, ...]) -> None:
        self._context.reports.refuse(command, findings)
        if command.reread:
            named = self._context.robot.joints.names
            first = findings[0]
            where = "" if first.joint is None else f"{named[first.joint]}: "
            self.failed(f"{where}{first.message}")

    def _publish_reload(self, command: link.ApplyChanges) -> None:
        context = self._context
        applied = sorted(command.changes)
        waiting = list(command.needs_restart)
        context.reports.reply(command, applied=applied, needs_restart=waiting)
        made = f"in force: {listed(applied)}" if applied else "nothing to change"
        left = f"; for a restart: {listed(waiting)}" if waiting else ""
        context.reports.event("warning" if waiting else "info", EventCode.RELOADED, made + left)
        if command.reread:
            self._end(f"restart for {listed(waiting)}" if waiting else "")

    def at_rest(self) -> tuple[Finding, ...]:
        """Return why limits and gains may not change now, as a BUSY finding; empty: they may.

        Reasons: a motion or procedure runs, a trajectory is judged, torque may be on, a bus serves a request.
        """
        context = self._context
        why = None
        if context.procedures.rank is not None:
            why = f"{context.procedures.rank.name.lower()} is under way: wait for its end"
        elif what := self._homing.busy():
            why = f"{what}: wait for its end"
        elif context.executor.motion not in (Motion.IDLE, Motion.HOLDING) or _still_stopping(context):
            why = "a motion is under way: `twindctl stop`, or wait for its end"
        elif self._gate_input.busy:
            why = "a trajectory is being judged: try again"
        elif occupied := next((port.name for port in context.hardware.ports if port.busy), None):
            why = f"a client reads, writes, scans or reboots on bus {occupied}: try again"
        elif context.condition.mode is Mode.LIVE and torque_possible(context):
            why = "torque is on, or not known to be off: `twindctl disarm`"
        elif context.condition.mode is Mode.LIVE and torque_off(context) is not True:
            why = _describe_unknown_torque(context)
        return (
            ()
            if why is None
            else (Finding(ReasonCode.BUSY, message=f"limits and gains change at rest only; {why}"),)
        )


# ------------------------------------------------------------------------------------------- when


def _describe_unknown_torque(context: ProcedureContext) -> str:
    """Return why torque is not known to be off: a bus has no reader, or joints have not answered.

    Torque may have been left on by the limits in force before.
    """
    port = next((port for port in context.hardware.ports if port.reader is None), None)
    if port is None:
        return "torque is not known to be off: wait until every servo has answered"
    away = port.trouble or "it is not open"
    return f"whether torque is on is not known of bus {port.name}: {away}; connect it, or restart the daemon"


def _still_stopping(context: ProcedureContext) -> bool:
    reference = context.executor.reference
    return reference is not None and bool(reference.velocity.any())


def outside(context: ProcedureContext, limits: JointLimits, now: float) -> tuple[Finding, ...]:
    """Return findings for joints inside the limits in force that would be outside of `limits`."""
    measured = context.robot.measured
    old = context.robot.limits
    places: list[Floats] = []
    if context.condition.mode is not Mode.SIM:
        fresh = now - measured.time + measured.age <= FRESH
        places.append(np.where(fresh, measured.position, np.nan))
    if context.condition.mode is not Mode.LIVE:
        places.append(context.robot.simulated.position)
    if context.executor.reference is not None:
        places.append(context.executor.reference.position)
    shrunk: Bools = (limits.lower > old.lower) | (limits.upper < old.upper)
    found: dict[int, Finding] = {}
    for place in places:
        beyond = shrunk & ((place < limits.lower) | (place > limits.upper))
        for joint in np.flatnonzero(beyond).tolist():
            value = float(place[joint])
            message = "stands outside the new limits: bring it inside, then reload"
            bound = limits.nearest(joint, value)
            found.setdefault(
                joint, Finding(ReasonCode.POS_LIMIT, joint, value=value, bound=bound, message=message)
            )
    return tuple(found[joint] for joint in sorted(found))


# ------------------------------------------------------------------------------------------- what


def put_in_force(context: ProcedureContext, parts: LoopParts, one: BoundRobot) -> None:
    """Set limits, ranges and gains of `one` in all parts. Raises before anything has changed."""
    binding = one.binding
    hardware = context.hardware
    enabler = parts.rewire(one) if parts.rewire is not None else None
    writers = {
        port.name: enabler(port.reader)
        for port in hardware.ports
        if enabler is not None and port.writer is not None and port.reader is not None
    }
    # All writers are made before any part changes: a gain that a driver refuses must leave the old ones
    # whole.
    outlook = None if context.robot.outlook is None else context.robot.outlook.within(binding.limits)
    hardware.clear()
    for port in hardware.ports:
        port.enabler = port.enabler if enabler is None else enabler
        port.writer = writers.get(port.name, port.writer)
    hardware.rejoin(binding.joint_map)
    parts.guard.limit(binding.limits, binding.ratings)
    parts.twin.take_gains(binding)
    context.executor.limits = binding.limits
    if context.robot.compensation is not None:
        context.robot.compensation.limit(binding.ratings, parts.guard.follow)
    if context.robot.observer is not None:
        context.robot.observer.take_gains(binding)
    context.robot.outlook = outlook
    context.robot.description = replace(
        context.robot.description,
        bound=one,
        joints=binding.joint_map,
        limits=binding.limits,
        ratings=binding.ratings,
    )


def thresholds_with(old: GateThresholds, changes: dict[str, Any]) -> GateThresholds:
    """Return the thresholds in force after these changes. Raises NotHot."""
    warn, block = hot_changes.thresholds(changes, old.latency_warn * 1e3, old.latency_block * 1e3)
    return replace(old, latency_warn=warn / 1e3, latency_block=block / 1e3)


def listed(keys: list[str]) -> str:
    """Return the first keys as text, and the number of further ones."""
    more = f" and {len(keys) - LISTED} more" if len(keys) > LISTED else ""
    return ", ".join(keys[:LISTED]) + more
