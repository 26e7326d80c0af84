"""Outcome of a call: what its procedure returns, and its caller replies. Values only."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from twind.robot.finding import Finding


@dataclass(frozen=True, slots=True)
class CallReply:
    """Reply to a call that succeeded, with the parameters of the interface."""

    parameters: Mapping[str, Any]
    continues: bool = False  # True: more replies to the same call follow


@dataclass(frozen=True, slots=True)
class CallRefusal:
    """Refusal of a call by the gate or by a procedure."""

    findings: Sequence[Finding]


@dataclass(frozen=True, slots=True)
class CallFailure:
    """Error of the interface, as `Busy` or `BusFailed`, with its parameters."""

    error: str
    parameters: Mapping[str, Any]


CallOutcome = CallReply | CallRefusal | CallFailure
