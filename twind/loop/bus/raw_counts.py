"""Last counts of every actuator on the wire, before any conversion: topic `raw`. Does no I/O."""

from math import inf, nan

import numpy as np

from twind.robot.arrays import Floats, Ints, every
from twind_drivers.bus import BusSample


class RawCounts:
    """Counts and efforts as received: without zero, turn or plausibility check.

    Arrays are (n,), in `JointMap` order.
    """

    def __init__(self, count: int) -> None:
        self.ticks: Ints = np.zeros(count, np.int64)  # meaningless where `heard_at` is -inf
        self.effort: Floats = np.full(count, nan)  # raw; NaN: not reported
        self.heard_at: Floats = np.full(count, -inf)  # s, of the last reply

    def take(self, places: slice | Ints, sample: BusSample) -> None:
        """Store the sample of a bus; actuators that did not reply keep their last values."""
        heard = sample.heard
        reported = sample.effort_told
        if every(heard) and reported is None:
            self.ticks[places] = sample.position
            self.effort[places] = sample.effort
            self.heard_at[places] = sample.received
            return
        self.ticks[places] = np.where(heard, sample.position, self.ticks[places])
        effort = sample.effort if reported is None else np.where(reported, sample.effort, nan)
        self.effort[places] = np.where(heard, effort, self.effort[places])
        self.heard_at[places] = np.where(heard, sample.received, self.heard_at[places])

    def age(self, time: float) -> Floats:
        """Return the seconds (n,) since each actuator's last reply, as of `time` (s); inf: never."""
        age: Floats = time - self.heard_at
        return age
