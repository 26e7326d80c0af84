"""When something is slow it is told once, and once that it is fast again: no line twice without the other."""

from dataclasses import dataclass
from math import isnan, nan

CALM = 0.8  # of the bound: what was told must stay below this share ...
CALM_FOR = 1.0  # s ... for longer than this before it counts as over, and may be told again


@dataclass(frozen=True, slots=True)
class LatencyAlert:
    """A hop became too slow, or it has recovered (`calm`)."""

    hop: str
    value: float  # s; NaN: calm because it is not measured any longer
    bound: float  # s
    calm: bool = False


class LatencyAlarm:
    """Hysteresis over one hop's durations. A negative one is as wrong as one that is too long.

    One that is not known (NaN) is no news, but nothing to be calm about either.
    """

    def __init__(self, hop: str) -> None:
        self._hop = hop
        self._high_at: float | None = None  # s, since it was told: when it was last not calm; None: it is

    def judge(self, value: float, bound: float, now: float) -> LatencyAlert | None:
        """One more duration, s, at `now`; what is to be told."""
        within = 0.0 <= value <= bound
        told = self._high_at
        if told is None:
            if within or isnan(value):
                return None
            self._high_at = now
            return LatencyAlert(self._hop, value, bound)
        if not (within and value <= CALM * bound):
            self._high_at = now
        elif now - told > CALM_FOR:
            self._high_at = None
            return LatencyAlert(self._hop, value, bound, calm=True)
        return None

    def drop(self) -> LatencyAlert | None:
        """The hop is not measured any longer: what was told of it is over, and that is to be told."""
        told = self._high_at
        self._high_at = None
        return None if told is None else LatencyAlert(self._hop, nan, nan, calm=True)
