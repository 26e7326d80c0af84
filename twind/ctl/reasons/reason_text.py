"""Text of one reason code: what it does, why it occurs and what to do. Pure data."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ReasonText:
    """One row of docs/reason-codes.md. Commands stand in backquotes."""

    effect: str  # refused, warning, change, or the reaction
    cause: str
    remedy: str  # one line of a terminal, at most 90 characters without backquotes
