"""Last check of command frames (WIRE_CLAMP): actuators of this robot, positions inside their bounds."""

import numpy as np

from twind_drivers.bus import Ints, WireRangeError
from twind_drivers.can.actuator_group import ActuatorGroup
from twind_drivers.can.can_units import COUNT
from twind_drivers.ports.frame import Frames

STEPS = 0xFFFF  # steps of a 16-bit field, the narrowest with a position, which is truncated to a step


class CommandFrameCheck:
    """Permitted positions of one bus: `lower`, `upper` (m,) in counts, inclusive.

    The bytes are decoded again, so one count beyond is permitted, or one step of a field that is coarser.
    """

    def __init__(self, fleet: ActuatorGroup, lower: Ints, upper: Ints) -> None:
        self._fleet = fleet
        self._lower = lower
        self._upper = upper
        self._widen()

    def judge(self, frames: Frames) -> None:
        """Raise WireRangeError for the first frame that may not leave."""
        fleet = self._fleet
        to = fleet.commanded_rows(frames)
        place = fleet.decode_commanded_position(frames)
        if self._ranges is not fleet.ranges:
            self._widen()
        if (to < 0).any():
            id = int(frames["id"][np.argmax(to < 0)])
            raise WireRangeError(fleet.name, id, id, min(fleet.ids), max(fleet.ids), "order to a frame id")
        outside = (place < self._least.take(to)) | (
            place > self._most.take(to)
        )  # an order without a position is NaN
        if outside.any():
            first = int(np.argmax(outside))
            row = int(to[first])
            bounds = float(self._lower[row]), float(self._upper[row])
            raise WireRangeError(fleet.name, fleet.ids[row], float(place[first]) / COUNT, *bounds, "goal")

    def _widen(self) -> None:
        """Set the permitted positions, rad, after an actuator has reported its ranges."""
        self._ranges = self._fleet.ranges
        step = np.nan_to_num(2.0 * self._ranges.position / STEPS / COUNT, nan=0.0, posinf=0.0)
        slack = np.maximum(1.0, step)
        self._least = (self._lower - slack) * COUNT
        self._most = (self._upper + slack) * COUNT
