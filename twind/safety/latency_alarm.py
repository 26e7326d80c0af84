"""Alarm of a slow hop with hysteresis: one report when it becomes slow, one when it has recovered."""

from dataclasses import dataclass
from math import isnan, nan

CALM = 0.8  # of the bound: durations must stay below this share ...
CALM_FOR = 1.0  # s ... for longer than this before the alarm ends and may begin again


@dataclass(frozen=True, slots=True)
class LatencyAlert:
    """Report that a hop became too slow, or has recovered (`calm`)."""

    hop: str
    value: float  # s; NaN: calm because it is not measured any longer
    bound: float  # s
    calm: bool = False


class LatencyAlarm:
    """Hysteresis over one hop's durations. A negative duration is as wrong as one that is too long.

    An unknown one (NaN) starts no alarm and ends none.
    """

    def __init__(self, hop: str) -> None:
        self._hop = hop
        # s, during an alarm: the last duration that was not calm; None: no alarm
        self._high_at: float | None = None

    @property
    def is_off(self) -> bool:
        """True without an alarm: a duration within its bound then changes nothing."""
        return self._high_at is None

    def judge(self, value: float, bound: float, now: float) -> LatencyAlert | None:
        """Process a duration (s) at `now` (s); return the report that it causes, or None."""
        within = 0.0 <= value <= bound
        since = self._high_at
        if since is None:
            if within or isnan(value):
                return None
            self._high_at = now
            return LatencyAlert(self._hop, value, bound)
        if not (within and value <= CALM * bound):
            self._high_at = now
        elif now - since > CALM_FOR:
            self._high_at = None
            return LatencyAlert(self._hop, value, bound, calm=True)
        return None

    def drop(self) -> LatencyAlert | None:
        """Process a hop that is not measured any longer: an alarm ends, with a report."""
        since = self._high_at
        self._high_at = None
        return None if since is None else LatencyAlert(self._hop, nan, nan, calm=True)
