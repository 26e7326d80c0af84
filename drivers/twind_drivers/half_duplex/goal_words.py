"""Goal packet of a bus, encoded each tick, then decoded from its bytes and checked (WIRE_CLAMP).

Plain loops: for up to some 24 devices they are faster than numpy calls. Pure.
"""

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from twind_drivers.bus import Bools, Ints, WireRangeError
from twind_drivers.flags import some
from twind_drivers.half_duplex.checksum_packet import sync_write

FIRST = 7  # where the first row begins
SIGN = 0x8000


class GoalEncoder(Protocol):
    """Packet of the goals of m devices, of which some get one. `places`: those, in order."""

    lower: Ints
    upper: Ints
    places: list[int]

    def choose(self, among: Bools) -> None:
        """Send goals to these devices (m,) alone."""

    def check(self, ticks: Ints) -> None:
        """Raise WireRangeError for the first goal (m,) out of range, ValueError for another shape."""

    def encode(self, ticks: Ints) -> bytes:
        """Return the packet of goals (m,); empty: no device gets any. Raises as `check`."""


class GoalWords:
    """Goals of m devices within `lower`..`upper`: words with sign and magnitude at `address`.

    `big_endian` (m,): byte order of each.
    """

    def __init__(
        self,
        name: str,
        address: int,
        ids: Sequence[int],
        big_endian: Sequence[bool],
        lower: Ints,
        upper: Ints,
    ) -> None:
        self.lower = lower
        self.upper = upper
        self._name = name
        self._address = address
        self._ids = tuple(ids)
        self._big_endian = tuple(big_endian)
        self.choose(np.zeros(len(self._ids), np.bool_))

    def choose(self, among: Bools) -> None:
        """Send goals to these devices (m,) alone: a goal can switch torque on."""
        self.places = np.flatnonzero(among).tolist()
        own = {self._ids[place]: b"\0\0" for place in self.places}
        self._packet = bytearray(sync_write(self._address, own)) if own else bytearray()
        self._fixed = sum(self._packet[2:-1])
        # place of the device, and of its low and high byte in the packet
        self._rows = [
            (place, at + self._big_endian[place], at + 1 - self._big_endian[place])
            for place, at in zip(self.places, range(FIRST + 1, len(self._packet), 3), strict=False)
        ]

    def check(self, ticks: Ints) -> None:
        """Raise WireRangeError for the first goal (m,) out of range, ValueError for another shape."""
        if ticks.shape != (len(self._ids),) or ticks.dtype.kind != "i":
            raise ValueError(f"{self._name}: {len(self._ids)} whole ticks needed, got {ticks!r}")
        outside = (ticks < self.lower) | (ticks > self.upper)
        if some(outside):
            raise self._error(int(outside.argmax()), int(ticks[outside.argmax()]))

    def encode(self, ticks: Ints) -> bytes:
        """Return the packet of goals (m,); empty: no device gets any. Raises as `check`."""
        self.check(ticks)
        if not self._rows:
            return b""
        data = self._packet
        values = ticks.tolist()
        total = self._fixed
        for place, low, high in self._rows:
            value = values[place]
            word = value if value >= 0 else SIGN - value
            data[low] = word & 0xFF
            data[high] = word >> 8 & 0xFF
            total += data[low] + data[high]
        data[-1] = ~total & 0xFF
        self._judge(values)
        return bytes(data)

    def _judge(self, values: Sequence[int]) -> None:
        """Decode the bytes again, so that an error of the encoder cannot reach a servo."""
        data = self._packet
        for place, low, high in self._rows:
            word = data[low] | data[high] << 8
            value = word if word < SIGN else SIGN - word
            if value != values[place] or data[min(low, high) - 1] != self._ids[place]:
                raise self._error(place, values[place])

    def _error(self, place: int, value: int) -> WireRangeError:
        return WireRangeError(
            self._name, self._ids[place], value, int(self.lower[place]), int(self.upper[place])
        )
