"""What was last on the wire of every actuator, before anything is made of it: topic `raw`. Does no I/O."""

from math import inf, nan

import numpy as np

from twind.robot.arrays import Floats, Ints, every
from twind_drivers.bus import BusSample


class RawCounts:
    """Counts and efforts as they were answered: no zero, no turn, and no judgement of what can be.

    Arrays are (n,), in `JointMap` order.
    """

    def __init__(self, count: int) -> None:
        self.ticks: Ints = np.zeros(count, np.int64)  # meaningless where `heard_at` is -inf
        self.effort: Floats = np.full(count, nan)  # raw; NaN: not told
        self.heard_at: Floats = np.full(count, -inf)  # s, of the last answer

    def take(self, places: slice | Ints, sample: BusSample) -> None:
        """Keep what a bus answered, of whom was heard; the others keep what they said last."""
        heard = sample.heard
        told = sample.effort_told
        if every(heard) and told is None:
            self.ticks[places] = sample.position
            self.effort[places] = sample.effort
            self.heard_at[places] = sample.received
            return
        self.ticks[places] = np.where(heard, sample.position, self.ticks[places])
        effort = sample.effort if told is None else np.where(told, sample.effort, nan)
        self.effort[places] = np.where(heard, effort, self.effort[places])
        self.heard_at[places] = np.where(heard, sample.received, self.heard_at[places])

    def age(self, time: float) -> Floats:
        """Seconds (n,) since each actuator answered, as of `time` (s); inf never."""
        age: Floats = time - self.heard_at
        return age
