"""DAMP procedure: torque stays and becomes soft, the goals follow the sinking robot, then torque goes off.

For a robot that cannot be lowered to its rest pose, or is falling already. The only way back is torque off
and arming anew: any procedure that takes the torque over continues to damp. Not verified on hardware.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twind.loop.bus.script_run import ScriptRun
from twind.loop.procedures.procedure_context import ProcedureContext
from twind.loop.procedures.procedure_runner import Steps
from twind.robot.event_codes import EventCode
from twind.robot.finding import Finding

# rad/s of the goals that follow the joints: a joint that falls faster is braked by the remaining stiffness
SINK = 0.5
SLOW = 0.05  # rad/s: a slower joint counts as at rest ...
# s at rest before torque goes off, and s until torque goes off at the latest: a joint that trembles must not
# keep torque on for ever
SLOW_FOR = 1.0
SLOW_MOST = 5.0


def demand(context: ProcedureContext, why: Sequence[Finding], now: float) -> None:
    """Allow only damping and torque off from now on; a motion to the rest pose under way ends."""
    if context.torque.demand_damping(now):
        because = f": {why[0].code}: {why[0].message}" if why else ""
        message = f"the robot is damped, then torque goes off: support it{because}"
        context.reports.event("error", EventCode.DAMP, message, tuple(why), stop="damp")


def damp(context: ProcedureContext) -> Steps:
    """Damp until every joint has been at rest for a second, at the latest some seconds after the demand."""
    now = context.clock.now()
    demand(context, (), now)
    assert context.torque.soft_since is not None  # just demanded
    until = context.torque.soft_since + SLOW_MOST
    quiet_since = now
    tasks = context.hardware.damp()
    # `reported` makes the report of unconfirmed devices a single one; the loop below never waits for them.
    reported = False
    while now < until and now - quiet_since < SLOW_FOR:
        context.executor.yield_to(context.hardware.reachable(context.robot.measured.position), SINK)
        if not reported and all(task.done for task in tasks):
            reported = True
            _report_unconfirmed(context, tasks)
        now = yield
        if not _quiet(context):
            quiet_since = now


def _quiet(context: ProcedureContext) -> bool:
    """True when every joint but limp ones has a fresh reading and is slow."""
    fresh = context.robot.measured.age <= SLOW_FOR
    slow = np.abs(context.robot.measured.velocity) <= SLOW
    return bool(((fresh & slow) | context.torque.limp).all())


def _report_unconfirmed(context: ProcedureContext, tasks: Sequence[ScriptRun[tuple[int, ...]]]) -> None:
    """Report the devices that did not confirm damping, without a wait for them.

    An e-stop counts as begun once every device has confirmed.
    """
    stiff = [id for task in tasks for id in task.result or ()]
    if not stiff and all(task.error is None for task in tasks):
        context.torque.confirm_stop_begun()
    if stiff:
        context.reports.event("error", EventCode.DAMP, f"ids {stiff} did not confirm that they are damped")
    for task in tasks:
        if task.error is not None:
            context.reports.event("error", EventCode.DAMP, f"not damped: {task.error}")
