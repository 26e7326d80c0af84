"""Outcome of a motion."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from twind.client import MotionFailed


@dataclass(frozen=True, slots=True)
class MotionOutcome:
    """A motion that succeeded. Times in s."""

    id: str
    duration: float  # of its path
    stretch: float  # by which it took longer
    stretched_by: tuple[str, ...]  # reason codes of that


def outcome_of(report: Mapping[str, Any]) -> MotionOutcome:
    """Return the outcome from the last report of a motion. Raises MotionFailed."""
    phase = str(report.get("phase"))
    if phase != "succeeded":
        raise MotionFailed(phase, report.get("findings") or ())
    return MotionOutcome(
        id=str(report.get("id") or ""),
        duration=report.get("duration") or 0.0,
        stretch=report.get("stretch") or 0.0,
        stretched_by=tuple(report.get("stretched_by") or ()),
    )
