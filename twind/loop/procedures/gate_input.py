"""Input of the gate for one request, collected from the loop. Loop's process; the gate alone judges."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from twind.loop.procedures.procedure_context import ProcedureContext
from twind.loop.procedures.torque_readback import torque_reported
from twind.loop.tick.loop_figures import LoopFigures
from twind.loop.tick.loop_parts import LoopParts
from twind.robot.arrays import Bools
from twind.robot.finding import Finding, ReasonCode, Verdict
from twind.robot.modes import RESET_STATES, Mode
from twind.robot.trajectory import Reference
from twind.safety import admission, gate
from twind.safety.headroom import JointCondition


class GateInput:
    """Snapshots for the gate, and what of it changes while the daemon runs."""

    def __init__(
        self,
        context: ProcedureContext,
        parts: LoopParts,
        figures: LoopFigures,
        troubles: Callable[[], Sequence[Finding]],
    ) -> None:
        """`troubles`: returns the findings on devices and joints that prevent arming."""
        self.thresholds = parts.thresholds  # in force; a reload replaces them
        self.judged_since = 0  # generation of the last change of the robot: older verdicts do not count
        self.busy = False  # a trajectory is being judged (BUSY)
        self.gains_tried_by = 0  # client whose gains are in force instead of the file's; 0: none
        self._context = context
        self._figures = figures
        self._guard = parts.guard
        self._lease = parts.lease
        self._health = parts.health
        self._troubles = troubles

    def snapshot(self, client: int, now: float) -> gate.GateSnapshot:
        """Collect the values that the gate needs for a request of `client`, as of `now` (s)."""
        context = self._context
        robot = context.robot
        live = context.condition.mode is Mode.LIVE
        target = robot.measured if live else robot.simulated
        still = np.zeros(len(robot.joints))
        reference = context.executor.reference or Reference(target.position, still, still)
        slow = context.hardware.slow
        condition = context.condition
        stopped = bool(condition.latches) or condition.state in RESET_STATES
        return gate.GateSnapshot(
            now=now,
            mode=context.condition.mode,
            state=context.condition.state,
            motion=context.executor.motion,
            latched=tuple(context.condition.latches),
            lease_held=self._lease.held_by(client, now),
            mismatches=tuple(self._troubles()),
            calibrated=np.array(robot.joints.calibrated),
            period=robot.period,
            torque_on=torque_reported(context) if stopped else None,
            limp=context.torque.limp,
            age=now - target.time + target.age,
            latency=self._health.latency(now),
            latency_p95=self._health.latency_p95(now),
            reference=reference,
            busy=self.busy,
            bars=self._guard.bars,
            holding=self._guard.holding(self._figures.missed_in_a_row if live else 0, robot.period),
            unreachable=context.condition.unreachable,
            condition=JointCondition(
                slow.temperature,
                slow.voltage,
                now - slow.health_time,
                robot.description.ratings,
                robot.joints.transmission_groups,
            ),
        )

    def foreign_gains(self, client: int) -> tuple[Finding, ...]:
        """Return BUSY if gains that another client than `client` tries are in force."""
        if self.gains_tried_by in (0, client):
            return ()
        message = "gains that another client tried are in force; those of the robot file follow: try again"
        return (Finding(ReasonCode.BUSY, message=message),)

    def may_arm(self, client: int, now: float, *, limp: Bools) -> Verdict:
        """Judge the request Arm of all joints but `limp` (n,): LEASE_MISSING to LATENCY_BLOCK.

        BUSY: gains that another client tries are in force.
        """
        verdict = admission.arming(self.snapshot(client, now), self.thresholds, ~limp)
        verdict = replace(verdict, refusals=(*verdict.refusals, *self.foreign_gains(client)))
        if self._context.condition.mode is Mode.LIVE and not self._context.hardware.connected:
            finding = Finding(ReasonCode.HW_DISCONNECTED, message="not every bus is open and identified")
            verdict = replace(verdict, refusals=(*verdict.refusals, finding))
        return verdict
