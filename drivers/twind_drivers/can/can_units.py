"""Raw units of a CAN bus, the same for all families: the ticks of the bus contract. Pure.

The families differ on the wire: fields of 12 and 16 bits over ranges of each motor, floats in turns. Their
codecs convert to these units and back; code above them is independent of the family.
"""

import math
from typing import Any

import numpy as np

from twind_drivers.bus import Ints

# Counts of one turn of the output. One count is 0.38 mrad, as one of the MIT frame over +-12.5 rad is: what
# the arming allows a joint to have moved (2.5 counts) is there as little as it is with a serial servo.
TURN = 16384
COUNT = 2.0 * math.pi / TURN  # rad; of a velocity rad/s
EFFORT = 1e-3  # N·m of one raw effort


def counts(value: Any) -> Ints:
    """Round rad or rad/s to whole counts. Raises ValueError for what is not finite."""
    exact = np.rint(np.asarray(value, np.float64) / COUNT)
    if not np.isfinite(exact).all():
        raise ValueError(f"{value} has no count")
    whole: Ints = exact.astype(np.int64)
    return whole
