"""Trajectories and setpoints on their way through the gate: judged in slices, followed, reported."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from math import inf
from typing import Any

import numpy as np

from twind import link
from twind.loop.ipc.call_outcome import CallOutcome, CallRefusal, CallReply
from twind.loop.procedures.gate_input import GateInput
from twind.loop.procedures.procedure_context import ProcedureContext
from twind.loop.procedures.procedure_runner import Procedure
from twind.loop.tick.contact_explanations import with_contact
from twind.loop.tick.loop_figures import LoopFigures
from twind.loop.tick.loop_parts import LoopParts
from twind.motion.time_scaling import Stretch
from twind.motion.trajectory_executor import GoalOutcome, GoalTolerances
from twind.robot.arrays import Bools, Ints
from twind.robot.event_codes import EventCode
from twind.robot.finding import Finding, ReasonCode, Verdict
from twind.robot.modes import Mode
from twind.robot.trajectory import Trajectory
from twind.safety import gate, setpoint_gate
from twind.safety.admission import admit
from twind.safety.lead_in import led_in
from twind.safety.stopped_stream import StoppedStream
from twind.telemetry.command_latency import STREAM, StartedCommand

# s: the age up to which the front's part of the verdict counts; it rests on a state that changes
STALE_VERDICT = 0.5
# points judged in one tick: some 2.5 ms when every single one is refused, a quarter of a tick at 100 Hz
SLICE = 250
PROGRESS = 0.1  # s between two reports of progress
ABOUT_NOW = frozenset(  # depend on the present state, not on the path
    {
        ReasonCode.LEASE_MISSING,
        ReasonCode.ESTOP_LATCHED,
        ReasonCode.FAULT_LATCHED,
        ReasonCode.SOCKETS_GONE,
        ReasonCode.NOT_ARMED,
        ReasonCode.JOINT_LIMP,
        ReasonCode.CALIB_MISSING,
        ReasonCode.CALIB_MISMATCH,
        ReasonCode.DEVICE_MISSING,
        ReasonCode.DEVICE_MISMATCH,
        ReasonCode.HW_DISCONNECTED,
        ReasonCode.LATENCY_BLOCK,
        ReasonCode.THERMAL_HEADROOM,
        ReasonCode.VOLTAGE_LOW,
        ReasonCode.BUSY,
    }
)


class TrajectorySubmissions:
    """The trajectory that is being judged, and those that are followed with `more`."""

    def __init__(
        self, context: ProcedureContext, parts: LoopParts, gate_input: GateInput, figures: LoopFigures
    ) -> None:
        self.stopped = StoppedStream()
        self.epoch = -1  # of the lease under which the motion was accepted
        self._context = context
        self._way = parts.way
        self._lease = parts.lease
        self._guard = parts.guard
        self._twin = parts.twin
        self._gate_input = gate_input
        self._figures = figures
        self._followed: dict[str, link.Submit] = {}
        self._report_at = -inf
        self._stops = 0  # requests to stop since the start

    # --------------------------------------------------------------------------- trajectories

    def begin(self, command: link.Submit, data: bytes, now: float) -> None:
        """Start to judge a trajectory.

        Replies `accepted` or Refused, or the verdict alone for `check_only`.
        """
        way = self._way
        clock = self._context.clock
        taken = None if command.check_only else way.take(command.received, clock.now(), inf)

        def answer(outcome: CallOutcome | None) -> None:
            assert outcome is not None  # every trajectory has one
            self._context.reports.answer(command, outcome)

        self._context.procedures.beside(self._judge(command, data, taken, now), answer)

    def _judge(
        self, command: link.Submit, data: bytes, taken: StartedCommand | None, now: float
    ) -> Procedure:
        context = self._context
        try:
            path = link.unpack_path(data, command, len(context.robot.joints))
        except ValueError as error:
            unfit = Verdict((Finding(ReasonCode.BAD_SHAPE, message=str(error)),))
            return self._refused(command, unfit, taken, now)
        if command.generation < self._gate_input.judged_since:
            message = "the limits were changed while this was judged: send it again"
            old = Verdict((Finding(ReasonCode.CMD_EXPIRED, message=message),))
            return self._refused(command, old, taken, now)
        waiting = command.start_in > 0.0 and context.executor.waiting > 0
        if self._gate_input.busy or (waiting and not command.check_only):
            message = (
                "another trajectory is being judged"
                if self._gate_input.busy
                else "one already waits for its start"
            )
            busy = Finding(ReasonCode.BUSY, message=f"{message}: try again, or cancel")
            return self._refused(command, Verdict((busy,)), taken, now)
        before = self._gate_input.snapshot(command.client, now)
        soon = 0.0 < command.start_in <= self._gate_input.thresholds.max_duration
        if soon and context.executor.reference is not None:
            before = replace(before, reference=context.executor.ahead(command.start_in))
        demand = gate.TrajectoryRequest(command.policy, command.append_stop, command.start_in)
        steps = gate.checking(path, before, context.robot.limits, demand, self._gate_input.thresholds, SLICE)
        self._gate_input.busy = True
        stops = self._stops
        sliced = False
        try:
            while True:
                try:
                    next(steps)
                except StopIteration as stop:
                    judged: gate.GateResult = stop.value
                    break
                sliced = True
                now = yield
        finally:
            self._gate_input.busy = False
        judged = replace(judged, verdict=with_front(judged.verdict, command))
        if command.check_only:
            return CallReply({"verdict": plain(of_the_path(judged.verdict, before.holding))})
        refusals = judged.verdict.refusals
        if sliced and not refusals:
            refusals = self._still_true(command, before, path.commanded, now)
            if stops != self._stops:
                message = "the robot was stopped while this was judged: send it again"
                refusals = (*refusals, Finding(ReasonCode.BUSY, message=message))
        verdict = Verdict(refusals, judged.verdict.warnings, judged.verdict.changes)
        if verdict.refusals:
            return self._refused(command, verdict, taken, now)
        followed = self._follow(command, judged.path, now)
        if isinstance(followed, Finding):
            return self._refused(command, replace(verdict, refusals=(followed,)), taken, now)
        self._on_its_way(command, taken, path.commanded)
        return self._accepted(command, verdict, followed, now)

    def _still_true(
        self, command: link.Submit, before: gate.GateSnapshot, commanded: Any, now: float
    ) -> tuple[Finding, ...]:
        """Return refusals that arose during a check of several ticks: admission and start must still hold."""
        context = self._context
        again = self._gate_input.snapshot(command.client, now)
        refusals = admit(again, commanded, self._gate_input.thresholds).refusals
        here = context.executor.reference
        held = ~context.torque.limp
        if here is None or not np.array_equal(here.position[held], before.reference.position[held]):
            message = "the robot moved while the trajectory was judged: a long one starts from a hold"
            refusals = (*refusals, Finding(ReasonCode.BUSY, message=message))
        return refusals

    def _follow(self, command: link.Submit, path: Trajectory, now: float) -> float | Finding:
        """Give an accepted path to the executor; return its lead-in time (s), or the refusal."""
        context = self._context
        if command.front_checked and now - command.front_checked > STALE_VERDICT:
            age = now - command.front_checked
            return Finding(
                ReasonCode.CMD_EXPIRED, value=age, bound=STALE_VERDICT, message="the front's verdict is old"
            )
        tolerances, goal_time = self._ending(command)
        self._lease.renew(command.client, now)
        lead = self._lead(path, command.start_in)
        refused = context.executor.submit(
            command.id,
            path,
            start_in=command.start_in,
            tolerances=tolerances,
            goal_time=goal_time,
        )
        return lead if refused is None else refused

    def _ending(self, command: link.Submit) -> tuple[GoalTolerances | None, float | None]:
        """Return the tolerances of a goal, and the time (s) to meet them after its end.

        A simulated joint must come as near to its goal as FOLLOW_ERR demands of a real one at rest. Without a
        goal tolerance of the client it has the time that starting and stopping at full speed takes twice.
        """
        context = self._context
        count = len(context.robot.joints)
        tolerances = command.tolerances
        if context.condition.mode is Mode.LIVE:
            return (GoalTolerances.from_entries(count, tolerances) if tolerances else None), command.goal_time
        bounds = self._guard.bounds
        own = any(goal is not None and goal > 0.0 for _, _, goal in tolerances)
        goal_time = command.goal_time if own else command.goal_time or bounds.drift_for
        return GoalTolerances.from_entries(count, tolerances, bounds.follow), goal_time

    def _lead(self, path: Trajectory, start_in: float) -> float:
        """Return the time (s) of the lead-in to a first point at t = 0, from the foreseen start position."""
        executor = self._context.executor
        if executor.reference is None:
            return 0.0
        before = executor.ahead(start_in) if start_in else executor.reference
        led = led_in(path, before, self._context.robot.limits, self._context.robot.period)
        return float(led.time[0] - path.time[0])

    def _accepted(self, command: link.Submit, verdict: Verdict, lead: float, now: float) -> CallReply:
        """Note an accepted motion; return its reply."""
        context = self._context
        context.robot.untouched = False
        self.epoch = self._lease.epoch
        context.reports.urgent = True
        if command.more:
            self._followed[command.id] = command
            self._lease.pin(command.client, command.id)
        self._send_verdict(command.id, verdict, now, lead)
        accepted = {"id": command.id, "phase": "accepted", "progress": 0.0, "verdict": plain(verdict)}
        return CallReply(accepted, continues=command.more)

    def _on_its_way(self, command: link.Submit, taken: StartedCommand | None, commanded: Bools) -> None:
        """Record the latencies of a submission.

        Of a delayed start only the verdict's, as the delay is intended.
        """
        assert taken is not None  # only a check has none
        reference = self._context.executor.reference
        assert reference is not None  # the path is followed from it
        at = self._context.clock.now()
        self._way.judge(taken, at)
        if not command.start_in:
            self._way.accept(taken, command.id, commanded, reference, at)

    def _refused(
        self, command: link.Submit, verdict: Verdict, taken: StartedCommand | None, now: float
    ) -> CallRefusal:
        """Report a refusal to subscribers and the log, unless the call only checks; return it."""
        context = self._context
        if taken is not None:
            self._way.judge(taken, context.clock.now())
            self._send_verdict(command.id, verdict, now)
            codes = list(dict.fromkeys(finding.code for finding in verdict.refusals))
            message = f"refused {command.id}: {', '.join(codes)}"
            context.reports.event("warning", codes[0], message, verdict.refusals[:8], id=command.id)
        return CallRefusal(verdict.refusals)

    def _send_verdict(self, id: str, verdict: Verdict, now: float, lead: float = 0.0) -> None:
        self._context.reports.verdict(id, plain(verdict), now, lead)

    # --------------------------------------------------------------------------- setpoints

    def setpoint(self, command: link.Setpoint, now: float) -> None:
        """Judge one streamed setpoint at once; accepted, it replaces the last."""
        context = self._context
        taken = self._way.take(command.received, context.clock.now())
        stream = context.executor.stream  # before this setpoint
        behind, late = (None, ()) if stream is None else stream.behind()
        judged = self._streamed(command, now)
        before = context.executor.reference
        at = context.clock.now()
        self._way.judge(taken, at)
        if judged.verdict.refusals:
            self._send_verdict(STREAM, judged.verdict, now)
            context.reports.refuse(command, judged.verdict.refusals)
            return
        assert before is not None  # the setpoint is followed from it
        self._way.accept(taken, STREAM, self._places(judged.joints), before, at)
        context.robot.untouched = False
        self.epoch = self._lease.epoch
        changes = [asdict(finding) for finding in (*judged.verdict.changes, *late)]
        lag = {"behind": behind[judged.joints].tolist()} if late and behind is not None else {}
        context.reports.reply(command, sequence=self._figures.ticks, changes=changes, **lag)

    def _streamed(self, command: link.Setpoint, now: float) -> setpoint_gate.SetpointResult:
        """Judge a setpoint, and follow it unless it is refused."""
        context = self._context
        snapshot = self._gate_input.snapshot(command.client, now)
        valid_for = command.remaining(now)
        joints = np.array(command.joints, np.int64)
        verdict = admit(snapshot, self._places(joints), self._gate_input.thresholds, setpoint=True)
        judged = setpoint_gate.judge(
            joints,
            np.array(command.positions, np.float64),
            None if command.velocities is None else np.array(command.velocities, np.float64),
            context.robot.limits,
            valid_for=valid_for,
            allow_clamp=command.allow_clamp,
        )
        stopped = self.stopped.refusal(command.client, now)
        refusals = (*verdict.refusals, *((stopped,) if stopped else ()), *judged.verdict.refusals)
        if not refusals and context.robot.outlook is not None:
            refusals = context.robot.outlook.refuses(
                context.executor, judged.joints, judged.position, judged.velocity
            )
        if not refusals:
            self._lease.renew(command.client, now, streaming=True)
            args = (judged.joints, judged.position, judged.velocity, valid_for)
            refused = context.executor.setpoint(*args)
            refusals = () if refused is None else (refused,)
            if refused is None:
                self.stopped.accept(command.client, now)
        return replace(judged, verdict=Verdict(refusals, changes=judged.verdict.changes))

    def _places(self, joints: Ints) -> Bools:
        return np.isin(np.arange(len(self._context.robot.joints)), joints)

    # --------------------------------------------------------------------------- outcomes

    def stop(self, client: int, now: float) -> None:
        """Stop the motion for `client`; a path that is still judged does not begin afterwards."""
        self._stops += 1
        self.stopped.stop(client, now)
        self._context.executor.stop()

    def drop_client(self, client: int) -> None:
        """Drop the reports for a connection that closed."""
        for name in [name for name, command in self._followed.items() if command.client == client]:
            self._unfollow(name)

    def forget(self) -> None:
        """Drop the reports for all connections."""
        self._followed.clear()

    def report(self, now: float) -> None:
        """Report progress ten times a second, and the end of each goal."""
        context = self._context
        for outcome in context.executor.outcomes():
            self._end(outcome)
        running = context.executor.progress()
        if running is not None and now >= self._report_at:
            self._report_at = now + PROGRESS
            command = self._followed.get(running[0])
            if command is not None:
                own = own_time(context.executor.stretch)
                context.reports.reply(
                    command, continues=True, id=command.id, phase="running", progress=running[1], **own
                )

    def _end(self, outcome: GoalOutcome) -> None:
        context = self._context
        if outcome.phase != "succeeded":
            self._way.end(outcome.id)
        level = "info" if outcome.phase in ("succeeded", "replaced", "cancelled") else "warning"
        findings = tuple(with_contact(context, self._twin, finding) for finding in outcome.findings)
        message = f"{outcome.id or 'streamed setpoints'} {outcome.phase}"
        context.reports.event(level, EventCode.MOTION, message, findings, id=outcome.id, phase=outcome.phase)
        context.reports.urgent = True
        command = self._unfollow(outcome.id)
        if command is not None:
            found = [asdict(finding) for finding in findings]
            own = own_time(outcome.stretch)
            done = {"progress": outcome.fraction, "findings": found, **own}
            context.reports.reply(command, id=command.id, phase=outcome.phase, **done)

    def _unfollow(self, name: str) -> link.Submit | None:
        command = self._followed.pop(name, None)
        if command is not None:
            self._lease.unpin(command.client, name)
        return command


def own_time(stretch: Stretch | None) -> dict[str, Any]:
    """Return the duration of a motion as accepted (s), and by how much (s) and why it takes longer."""
    if stretch is None:
        return {}
    reasons = list(stretch.reasons)
    return {"duration": stretch.duration, "stretch": stretch.added, "stretched_by": reasons}


def with_front(verdict: Verdict, command: link.Submit) -> Verdict:
    """Join the loop's part of a verdict with the front's, SELF_COLLISION to UNSTABLE_POSE."""
    refusals = (*verdict.refusals, *command.refused)
    warnings = (*verdict.warnings, *command.warned)
    return Verdict(refusals, warnings, verdict.changes)


def of_the_path(verdict: Verdict, holding: Sequence[Finding] = ()) -> Verdict:
    """Return the verdict of a check: findings on the client or the robot's state become warnings.

    They are no fault of the path. `holding`: findings for which the guard holds any motion now.
    """
    about_now = [one for one in verdict.refusals if one.code in ABOUT_NOW or one in holding]
    refusals = tuple(one for one in verdict.refusals if one not in about_now)
    return Verdict(refusals, (*verdict.warnings, *about_now), verdict.changes)


def plain(verdict: Verdict) -> dict[str, Any]:
    """Return a verdict as the link carries it; joints are still indices."""
    return {
        "refusals": [asdict(finding) for finding in verdict.refusals],
        "warnings": [asdict(finding) for finding in verdict.warnings],
        "changes": [asdict(finding) for finding in verdict.changes],
    }
