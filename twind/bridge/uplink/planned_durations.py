"""Planned durations of motions, from the daemon's reports of accepted trajectories. For two threads."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Mapping
from typing import Any

KEPT = 64  # motions that are remembered
MOST = 0.99  # of its time: that a motion has ended is the daemon's word alone


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
            while len(self._planned) > KEPT:
                self._planned.popitem(last=False)

    def share(self, name: str, now: float) -> float:
        """Return the elapsed share of a motion's planned time, 0..MOST.

        MOST is below 1, since a motion that is slowed on the way ends later.
        """
        with self._lock:
            begins, lasts = self._planned.get(name, (now, 1.0))
        return min(MOST, max(0.0, (now - begins) / max(lasts, 1e-3)))
