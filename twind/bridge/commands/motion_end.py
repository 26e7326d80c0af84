"""End of a motion, as `Monitor` reports it. Standard library, Python 3.10."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

STOPPED = ("cancelled", "aborted")  # ends after which the robot is not where its sender expects it
ENDS = ("succeeded", "replaced", *STOPPED)
LOST = "lost"  # phase of an end that was not received, or cannot be read
# Codes of `twind.robot`, whose enumerations need Python 3.11
MOTION = "MOTION"
LEASE_LOST = "LEASE_LOST"
BUSY = "BUSY"

Findings = Sequence[Mapping[str, Any]]
BROKEN: Findings = (
    {"code": LEASE_LOST, "message": "the connection to the daemon broke: it lets go of such motions"},
)
UNREPORTED: Findings = (
    {"code": LEASE_LOST, "message": "no report of its end came, though nothing moves any more: see the log"},
)
UNREADABLE: Findings = (
    {
        "code": "INTERNAL",
        "message": "the daemon reported an end with a phase unknown to this bridge: restart both, so that "
        "their versions are the same",
    },
)
BRIDGE_ENDED: Findings = (
    {"code": LEASE_LOST, "message": "the bridge ended: the robot decelerates and holds"},
)


@dataclass(frozen=True, slots=True)
class MotionEnd:
    """End of a motion. `phase`: succeeded, cancelled, replaced, aborted, or lost (the end is unknown)."""

    id: str
    phase: str
    findings: Findings = ()

    @property
    def stopped(self) -> bool:
        """The robot is not where the sender of the motion expects it."""
        return self.phase in (*STOPPED, LOST)


def reported_end(answer: Mapping[str, Any]) -> MotionEnd | None:
    """The end of a motion that this answer of `Monitor` reports; None: it reports none.

    An end whose phase is missing (older daemons) or unknown is LOST. Its id is then "" where the daemon gives
    none: any motion may have ended, so every motion is over. Streamed setpoints end with id "" as well.
    """
    if answer["topic"] != "events" or answer["event"]["code"] != MOTION:
        return None
    event = answer["event"]
    name = event.get("id") or ""
    phase = event.get("phase")
    return MotionEnd(name, phase, event["findings"]) if phase in ENDS else MotionEnd(name, LOST, UNREADABLE)
