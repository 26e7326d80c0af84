"""How long the daemon plans motions to last, by its news of what it accepted. For two threads."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Mapping
from typing import Any

KEPT = 64  # motions that are remembered
MOST = 0.99  # of its time: that a motion has ended is the daemon's word alone


class PlannedDurations:
    """By the daemon's id."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._planned: OrderedDict[str, tuple[float, float]] = OrderedDict()  # s: begins, lasts

    def heard(self, news: Mapping[str, Any]) -> None:
        """One answer of `Monitor`, topic trajectories."""
        path = news["accepted"]["trajectory"]
        begins = news["time"] + (path.get("start_in") or 0.0)
        with self._lock:
            self._planned[news["accepted"]["id"]] = begins, path["points"][-1]["time_from_start"]
            while len(self._planned) > KEPT:
                self._planned.popitem(last=False)

    def share(self, name: str, now: float) -> float:
        """Of its planned time, 0..MOST: one that is slowed on the way ends later."""
        with self._lock:
            begins, lasts = self._planned.get(name, (now, 1.0))
        return min(MOST, max(0.0, (now - begins) / max(lasts, 1e-3)))
