"""Findings of joints that stay back in the simulation name the contact that blocks them. Loop's process."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from twind.robot.finding import Finding, ReasonCode
from twind.robot.modes import Mode
from twind.safety.tracking_rules import DRIFT

if TYPE_CHECKING:
    from twind.loop.tick.control_loop import Loop

REMEDY = "correct these shapes in the model, exclude the pair there, or choose another goal"


def with_contact(loop: Loop, finding: Finding) -> Finding:
    """`finding`, with the simulated contact that blocks its joint in its message where there is one.

    Every other finding is returned as it is. The contact is searched for here, when a finding is reported.
    """
    if finding.joint is None or not _simulated(loop, finding.code):
        return finding
    contact = loop.twin.contact(finding.joint)
    if contact is None:
        return finding
    one, other = contact.bodies
    touch = f"{one} and {other} touch in the simulation, {contact.depth * 1e3:.1f} mm deep: {REMEDY}"
    what = f"{DRIFT}: " if finding.code is ReasonCode.MIRROR_DRIFT else ""
    return replace(finding, message=what + touch)


def _simulated(loop: Loop, code: ReasonCode) -> bool:
    """Check whether a finding of this code compares with the simulation."""
    return code is ReasonCode.MIRROR_DRIFT or (
        code is ReasonCode.GOAL_TOLERANCE and loop.mode is not Mode.LIVE
    )
