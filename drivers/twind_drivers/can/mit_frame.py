"""Bit layout and scaling of MIT frames, which all packed frames share. Pure.

Five values become whole numbers of 12 and 16 bits over ranges of each actuator. The layout is that of the
CubeMars AK manual V1.0.8, p. 48-49, which Damiao and RobStride share. Numbers are truncated, not rounded, as
in every public encoder of it: 0 is 7FFF and is decoded as half a count below 0.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twind_drivers.bus import Bools, Floats, Ints, WireRangeError
from twind_drivers.can.actuator_family import FieldRanges
from twind_drivers.ports.frame import BYTES, Frames, Octets

Words = NDArray[np.uint64]

NAMES = ("position", "velocity", "kp", "kd", "torque")  # in order of the wire
BITS = (16, 12, 12, 12, 12)
WIDE = (16, 16, 16, 16, 16)  # RobStride's own protocol
# N·m/rad and N·m·s/rad: the gain fields span 0 to this in all three vendors' frames
KP = 500.0
KD = 5.0

# As wide as any bus has actuators: arrays of one shape and type take a third of the time of broadcast ones.
_WIDTH = 64
_SPECIAL = 0xFFFF_FFFF_FFFF_FFF0  # from here on a payload is an order: seven FF and what it wants
_COMMAND = np.repeat(np.array([48, 36, 24, 12, 0], np.uint64)[:, None], _WIDTH, axis=1)
_REPLY = np.repeat(np.array([40, 28, 16], np.uint64)[:, None], _WIDTH, axis=1)  # behind the byte with the id
_REPLY_MASK = np.repeat(np.array([0xFFFF, 0xFFF, 0xFFF], np.uint64)[:, None], _WIDTH, axis=1)


def _wide(constants: Words, count: int) -> Words:
    """Columns of `constants` for `count` actuators or frames; one to broadcast where there are too many."""
    return constants[:, :count] if count <= _WIDTH else constants[:, :1]


def pack(fields: Words) -> Words:
    """Payloads (k,) as one number each, first byte highest, of fields (5, k), each within its bits."""
    words: Words = np.bitwise_or.reduce(fields << _wide(_COMMAND, fields.shape[1]), axis=0)
    return words


def unpack(data: Octets) -> Floats:
    """Fields (3, j), position, velocity and torque, of replies (j, 8), of which D1 to D5 are read.

    Whole numbers, as floats: what `FieldScale.values` takes.
    """
    words = np.ascontiguousarray(data).view(">u8")[:, 0].astype(np.uint64)
    fields = (words >> _wide(_REPLY, len(words))) & _wide(_REPLY_MASK, len(words))
    return fields.astype(np.float64)


def commands(scale: "FieldScale", fields: Words) -> Octets:
    """Payloads (k, 8) of fields (5, k). Raises WireRangeError for one with the form of a special frame.

    That is one with everything at its upper end and a torque just below it.
    """
    words = pack(fields)
    if words.max(initial=0) >= _SPECIAL:
        row = int(words.argmax())
        raise WireRangeError(
            scale.port, scale.ids[row], float(fields[4, row]), 0.0, float(0xFEF), "torque field"
        )
    octets: Octets = words.astype(">u8").view(np.uint8).reshape(-1, 8)
    return octets


def is_special_frame(frames: Frames) -> Bools:
    """Return which frames on a motor's id are no motion command: seven FF and F0 or above, or not 8 bytes."""
    words = np.ascontiguousarray(frames["data"]).view(">u8")[:, 0]
    orders: Bools = (words >= _SPECIAL) | (frames["size"] != BYTES)
    return orders


def checked(port: str, ids: Sequence[int], values: Floats, lower: Floats, upper: Floats) -> None:
    """WireRangeError for the first of `values` (5, k) that is NaN or outside `lower`..`upper`, inclusive."""
    inside = (values >= lower) & (values <= upper)
    if inside.all():
        return
    field, row = (int(place) for place in np.argwhere(~inside)[0])
    bounds = float(lower[field, row]), float(upper[field, row])
    raise WireRangeError(port, ids[row], float(values[field, row]), *bounds, what=NAMES[field])


def bounds(ranges: FieldRanges) -> tuple[Floats, Floats]:
    """Return lower and upper ends (5, k), in order of `NAMES`. Raises ValueError for one not positive."""
    upper = np.array((ranges.position, ranges.velocity, ranges.kp, ranges.kd, ranges.torque), np.float64)
    if not ((upper > 0.0) & np.isfinite(upper)).all():
        field, row = (int(place) for place in np.argwhere(~((upper > 0.0) & np.isfinite(upper)))[0])
        raise ValueError(
            f"range of {NAMES[field]} of actuator {row} (from 0) is {upper[field, row]}: a positive number "
            "is needed; give it in the robot file, or mend the actuator's register"
        )
    lower = -upper
    lower[2:4] = 0.0
    return lower, upper


class FieldScale:
    """Scale between SI and whole fields for k actuators, by their ranges at its creation."""

    __slots__ = ("_base", "_least", "_lower", "_most", "_place", "_span", "_step", "_upper", "ids", "port")

    def __init__(
        self,
        port: str,
        ids: Sequence[int],
        ranges: FieldRanges,
        bits: tuple[int, ...],
        reply_bits: tuple[int, ...],
    ) -> None:
        """Make the scale; `bits`: of the fields of a command; `reply_bits`: of position, velocity, torque."""
        self.port = port
        self.ids = tuple(ids)
        self._lower, self._upper = bounds(ranges)
        self._span = self._upper - self._lower
        self._most = np.repeat([[2.0**width - 1.0] for width in bits], len(self.ids), axis=1)
        place = [0, 1, 4]
        self._base = self._lower[place]
        self._step = self._span[place] / np.array([2.0**width - 1.0 for width in reply_bits])[:, None]
        # of a commanded position
        self._least = self._lower[0]
        self._place = self._span[0] / self._most[0]

    def fields(self, position: Floats, velocity: Floats, kp: Floats, kd: Floats, torque: Floats) -> Words:
        """Whole fields (5, k) of values (k,) each. Raises WireRangeError for what a field cannot hold."""
        values = np.array((position, velocity, kp, kd, torque), np.float64)
        if values.shape != self._lower.shape:
            raise ValueError(f"{self.port}: {values.shape} values for {self._lower.shape} fields")
        checked(self.port, self.ids, values, self._lower, self._upper)
        whole: Words = ((values - self._lower) * self._most / self._span).astype(np.uint64)
        return whole

    def values(self, fields: Floats, rows: Ints) -> Floats:
        """Return position, velocity, torque (3, j) in SI of reply fields (3, j) of actuators `rows` (j,)."""
        values: Floats = fields * self._step.take(rows, axis=1)
        values += self._base.take(rows, axis=1)
        return values

    def decode_commanded_position(self, frames: Frames, rows: Ints, motion: Bools) -> Floats:
        """Position (j,) in rad that frames (j,) to `rows` command; NaN where it is no `motion` command."""
        if motion.all():
            return self.position(frames["data"], rows)
        position = np.full(len(frames), np.nan)
        position[motion] = self.position(frames["data"][motion], rows[motion])
        return position

    def position(self, data: Octets, rows: Ints) -> Floats:
        """Return the position (j,) in rad of commands (j, 8) to `rows`: 16 bits in D0 and D1."""
        field = data[:, 0] * 256.0 + data[:, 1]
        position: Floats = self._least.take(rows) + field * self._place.take(rows)
        return position
