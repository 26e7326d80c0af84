"""Deadlines of the periods of control in real time."""

from collections.abc import Sequence
from math import floor

import numpy as np

from twind.robot_client.state_message import StateMessage

MARGIN = 3e-4  # s after which a state that comes as usual is there
PERIODS = 3.0  # that a setpoint may be followed without the next, and for how long at least and at most (s)
SHORTEST = 0.03
LONGEST = 0.1  # the gate's bound


def validity(period: float) -> float:
    """Return how long (s) a setpoint may be followed without the next, where one comes every `period` s."""
    return min(LONGEST, max(PERIODS * period, SHORTEST))


class RateTimer:
    """Deadlines `period` s apart, from `first` on (s, monotonic)."""

    def __init__(self, first: float, period: float) -> None:
        self.deadline = first
        self.period = period
        self.missed = 0

    def advance(self, now: float) -> int:
        """Go on to the next deadline that has not passed. Return how many were missed."""
        skipped = max(0, floor((now - self.deadline) / self.period))
        self.deadline += (skipped + 1) * self.period
        self.missed += skipped
        return skipped


def in_step(states: Sequence[StateMessage], now: float, period: float, loop: float) -> RateTimer:
    """Return a timer whose deadlines lie just after a state has come: a setpoint then meets the next tick.

    `states`: of consecutive ticks, the newest last; `loop`: the loop's period, s. Both clocks are this
    machine's, and the loop keeps its phase, so it is found once.
    """
    # The median: on a busy machine a state that is late is a tick old, and the setpoint still meets the next.
    way = float(np.median([each.arrived - each.time for each in states])) + MARGIN
    first = states[-1].time + min(way, 0.9 * loop)
    return RateTimer(first + max(0, floor((now - first) / loop) + 1) * loop, period)
