"""Goals of remote clients, each once, with their newest report. Pure."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from twind.bridge.commands.leased_motions import refusal
from twind.bridge.uplink.remote_contract import busy, invalid
from twind.client.errors import CallError
from twind.robot.finding import ReasonCode

MOST = 256  # goals that are remembered
AHEAD = 60.0  # s that a deadline may lie ahead


@dataclass(slots=True)
class RemoteGoal:
    """Goal of a remote client. `answer`: its newest report; `refusal` instead, if it never began."""

    name: str
    lease: str
    deadline: float  # s
    id: str = ""  # the daemon's
    answer: dict[str, Any] = field(default_factory=dict)
    refusal: CallError | None = None
    over: bool = False

    def latest_reply(self) -> dict[str, Any]:
        """Return the newest report. Raises CallError: it was refused."""
        if self.refusal is not None:
            raise self.refusal.with_traceback(None)
        return self.answer


def in_time(deadline: float, now: float) -> None:
    """Raise CallError if a goal may no longer begin, or its deadline is too far ahead."""
    if not now <= deadline:
        text = "it came after its deadline"
        raise refusal(ReasonCode.CMD_EXPIRED, text, value=now - deadline, bound=0.0)
    if not deadline - now <= AHEAD:
        raise invalid("deadline", f"{deadline - now:.1f} s ahead; at most {AHEAD:g}")


class RemoteGoalTable:
    """Goals that may still be queried.

    An ended one is removed after its deadline: by then a late copy of the same message can move nothing.
    """

    def __init__(self) -> None:
        self._goals: dict[str, RemoteGoal] = {}

    def find_repeated(self, name: str, lease: str) -> RemoteGoal | None:
        """Return the goal of that name, if it exists. Raises CallError: it belongs to another lease."""
        known = self._goals.get(name)
        if known is not None and known.lease != lease:
            raise invalid("goal", f"{name[:64]!r} was used before, under another lease: a name is used once")
        return known

    def begin(self, name: str, lease: str, deadline: float, now: float) -> RemoteGoal:
        """Record a new goal. Raises CallError: too late, too far ahead, or too many."""
        in_time(deadline, now)
        if len(self._goals) >= MOST:
            kept = {each.name: each for each in self._goals.values() if now <= each.deadline or _runs(each)}
            self._goals = kept
        if len(self._goals) >= MOST:
            raise busy(f"{MOST} goals within {AHEAD:g} s: send longer ones")
        goal = self._goals[name] = RemoteGoal(name, lease, deadline)
        return goal


def _runs(goal: RemoteGoal) -> bool:
    return bool(goal.id) and not goal.over
