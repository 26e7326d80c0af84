"""The last check of command frames (WIRE_CLAMP): actuators of this robot, positions inside their bounds."""

import numpy as np

from twind_drivers.bus import Ints, WireClamp
from twind_drivers.can.actuator_group import ActuatorGroup
from twind_drivers.can.can_units import COUNT
from twind_drivers.can.frame import Frames

STEPS = 0xFFFF  # of a field of 16 bits, the narrowest that carries a position: it is truncated to one


class CanWireCheck:
    """What may be ordered on one bus: `lower`, `upper` (m,) in counts, inclusive.

    Judged is what the bytes say, so one count is allowed beyond, or one step of a field that is coarser.
    """

    def __init__(self, fleet: ActuatorGroup, lower: Ints, upper: Ints) -> None:
        self._fleet = fleet
        self._lower = lower
        self._upper = upper
        self._widen()

    def judge(self, frames: Frames) -> None:
        """Raises WireClamp for the first frame that may not leave."""
        fleet = self._fleet
        to = fleet.commanded_rows(frames)
        place = fleet.decode_commanded_position(frames)
        if self._ranges is not fleet.ranges:
            self._widen()
        if (to < 0).any():
            id = int(frames["id"][np.argmax(to < 0)])
            raise WireClamp(fleet.name, id, id, min(fleet.ids), max(fleet.ids), "order to a frame id")
        outside = (place < self._least.take(to)) | (
            place > self._most.take(to)
        )  # an order without one is NaN
        if outside.any():
            first = int(np.argmax(outside))
            row = int(to[first])
            bounds = float(self._lower[row]), float(self._upper[row])
            raise WireClamp(fleet.name, fleet.ids[row], float(place[first]) / COUNT, *bounds, "goal")

    def _widen(self) -> None:
        """What the bytes may say, rad: an actuator has told its ranges."""
        self._ranges = self._fleet.ranges
        step = np.nan_to_num(2.0 * self._ranges.position / STEPS / COUNT, nan=0.0, posinf=0.0)
        slack = np.maximum(1.0, step)
        self._least = (self._lower - slack) * COUNT
        self._most = (self._upper + slack) * COUNT
