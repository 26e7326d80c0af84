"""Findings of joints that stay back in the simulation name the contact that blocks them. Loop's process."""

from __future__ import annotations

from dataclasses import replace

from twind.loop.procedures.procedure_context import ProcedureContext
from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Mode
from twind.safety.tracking_rules import DRIFT
from twind.twin.twin import Twin

REMEDY = "correct these shapes in the model, exclude the pair there, or choose another goal"


def with_contact(context: ProcedureContext, twin: Twin, finding: Finding) -> Finding:
    """`finding`, with the simulated contact that blocks its joint in its message where there is one.

    Every other finding is returned as it is. The contact is searched for here, when a finding is reported.
    """
    if finding.joint is None or not _simulated(context, finding.code):
        return finding
    contact = twin.contact(finding.joint)
    if contact is None:
        return finding
    one, other = contact.bodies
    touch = f"{one} and {other} touch in the simulation, {contact.depth * 1e3:.1f} mm deep: {REMEDY}"
    what = f"{DRIFT}: " if finding.code is ReasonCode.MIRROR_DRIFT else ""
    return replace(finding, message=what + touch)


def _simulated(context: ProcedureContext, code: ReasonCode) -> bool:
    """Check whether a finding of this code compares with the simulation."""
    return code is ReasonCode.MIRROR_DRIFT or (
        code is ReasonCode.GOAL_TOLERANCE and context.condition.mode is not Mode.LIVE
    )
