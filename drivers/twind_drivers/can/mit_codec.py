"""Base of the codecs whose commands are MIT frames on the ids of the actuators. Pure."""

from collections.abc import Mapping, Sequence

import numpy as np

from twind_drivers.bus import Bools, Floats
from twind_drivers.can.actuator_family import ActuatorFamily, FieldRanges, ValuelessCommand
from twind_drivers.can.id_lookup import NONE, checked_ids, row_of, to_one
from twind_drivers.can.mit_frame import BITS, FieldScale, commands, is_special_frame
from twind_drivers.ports.frame import BYTES, STANDARD_MASK, Frames, frames


class MitCodec(ActuatorFamily):
    """Codec of k actuators of one bus in MIT mode; a family adds its replies and registers."""

    product: str  # for error messages
    orders: Mapping[ValuelessCommand, int]  # last byte, behind seven FF

    def __init__(self, port: str, ids: Sequence[int], ranges: FieldRanges) -> None:
        """Make the codec. Raises ValueError for ids outside 1..FF or twice the same."""
        self.port = port
        self.ids = checked_ids(port, self.name, ids, 1, 0xFF)
        self.replies: Bools = np.ones(len(self.ids), np.bool_)
        self._hears = np.full(STANDARD_MASK + 2, NONE, np.int64)
        self._hears[list(self.ids)] = range(len(self.ids))
        self._blank = frames(self.ids)
        self._blank["size"] = BYTES
        self._take(ranges)

    def _take(self, ranges: FieldRanges) -> None:
        self.scale = FieldScale(self.port, self.ids, ranges, BITS, BITS[:2] + BITS[4:])
        self.ranges = ranges

    def command(self, position: Floats, velocity: Floats, kp: Floats, kd: Floats, torque: Floats) -> Frames:
        """One MIT frame each. Raises WireRangeError naming id, field, value and range."""
        made = self._blank.copy()
        fields = self.scale.fields(position, velocity, kp, kd, torque)
        made["data"] = commands(self.scale, fields)
        return made

    def encode_valueless_command(self, row: int, what: ValuelessCommand) -> Frames:
        """Encode the order's byte behind seven FF. Raises ValueError for an order that the family lacks."""
        if what not in self.orders:
            raise ValueError(f"{self.port}: id {self.ids[row]}: a {self.product} has no {what.name.lower()}")
        return to_one(self.ids[row], b"\xff" * 7 + bytes([self.orders[what]]))

    def decode_commanded_position(self, frames: Frames) -> Floats:
        """Return the position of each MIT command to an id of this bus, rad.

        NaN: another or a special frame.
        """
        rows = row_of(self._hears, frames["id"])
        motion = (rows >= 0) & ~is_special_frame(frames)
        return self.scale.decode_commanded_position(frames, rows, motion)
