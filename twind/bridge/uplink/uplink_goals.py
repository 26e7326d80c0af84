"""Goals of remote clients, each once, with their results and planned durations. Pure.

`PlannedDurations` is safe for several threads, `UplinkGoalTable` is not.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from twind.bridge.uplink.remote_contract import busy, invalid, make_refusal
from twind.client.errors import CallError
from twind.robot.finding import ReasonCode

MOST = 256  # goals that are remembered
AHEAD = 60.0  # s that a deadline may lie ahead


@dataclass(slots=True)
class UplinkGoal:
    """Goal of a remote client. `answer`: its newest report; `refusal` instead, if it never began."""

    name: str
    lease: str
    deadline: float  # s
    id: str = ""  # the daemon's
    answer: dict[str, Any] = field(default_factory=dict)
    refusal: CallError | None = None
    over: bool = False

    def latest_reply(self) -> dict[str, object]:
        """Return the newest report. Raises CallError: it was refused."""
        if self.refusal is not None:
            raise self.refusal
        return self.answer


def in_time(deadline: float, now: float) -> None:
    """Raise CallError if a goal may no longer begin, or its deadline is too far ahead."""
    if not now <= deadline:
        raise make_refusal(ReasonCode.CMD_EXPIRED, "it came after its deadline", now - deadline, 0.0)
    if not deadline - now <= AHEAD:
        raise invalid("deadline", f"{deadline - now:.1f} s ahead; at most {AHEAD:g}")


class UplinkGoalTable:
    """Goals that may still be queried.

    An ended one is removed after its deadline: by then a late copy of the same message can move nothing.
    """

    def __init__(self) -> None:
        self._goals: dict[str, UplinkGoal] = {}

    def find_repeated(self, name: str, lease: str) -> UplinkGoal | None:
        """Return the goal of that name, if it exists. Raises CallError: it belongs to another lease."""
        known = self._goals.get(name)
        if known is not None and known.lease != lease:
            raise invalid("goal", f"{name[:64]!r} was used before, under another lease: a name is used once")
        return known

    def begin(self, name: str, lease: str, deadline: float, now: float) -> UplinkGoal:
        """Record a new goal. Raises CallError: too late, too far ahead, or too many."""
        in_time(deadline, now)
        if len(self._goals) >= MOST:
            self._forget(now)
        if len(self._goals) >= MOST:
            raise busy(f"{MOST} goals within {AHEAD:g} s: send longer ones")
        goal = self._goals[name] = UplinkGoal(name, lease, deadline)
        return goal

    def running(self) -> list[UplinkGoal]:
        """Return the accepted goals that have not ended."""
        return [goal for goal in self._goals.values() if goal.id and not goal.over]

    def _forget(self, now: float) -> None:
        self._goals = {
            name: goal
            for name, goal in self._goals.items()
            if now <= goal.deadline or (goal.id and not goal.over)
        }


KEPT_PLANS = 64  # motions that are remembered
MOST_SHARE = 0.99  # of its time: only the daemon reports the end of a motion


class PlannedDurations:
    """Begin and duration of each motion, by the daemon's id."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._planned: OrderedDict[str, tuple[float, float]] = OrderedDict()  # s: begins, lasts

    def on_monitor_reply(self, news: Mapping[str, Any]) -> None:
        """Record one answer of `Monitor`, topic trajectories."""
        path = news["accepted"]["trajectory"]
        begins = news["time"] + (path.get("start_in") or 0.0)
        with self._lock:
            self._planned[news["accepted"]["id"]] = begins, path["points"][-1]["time_from_start"]
            while len(self._planned) > KEPT_PLANS:
                self._planned.popitem(last=False)

    def share(self, name: str, now: float) -> float:
        """Return the elapsed share of a motion's planned time, 0..MOST_SHARE.

        MOST_SHARE is below 1, since a motion that is slowed on the way ends later.
        """
        with self._lock:
            begins, lasts = self._planned.get(name, (now, 1.0))
        return min(MOST_SHARE, max(0.0, (now - begins) / max(lasts, 1e-3)))
