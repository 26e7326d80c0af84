"""The goal packet: encoded in place each tick, then read back from its own bytes and judged (R22). Pure."""

import numpy as np
from numpy.typing import NDArray

from twind_drivers.bus import Ints, WireClamp
from twind_drivers.dynamixel.crc import Crc
from twind_drivers.dynamixel.layout import Block
from twind_drivers.dynamixel.packet import PATTERN, stuff, sync_write, unstuff

ROW = np.dtype([("id", "u1"), ("goal", "<i4")])
BODY = 7  # where INST begins
FIRST = 12  # where the first row begins


class GoalPacket:
    """A sync write of one goal position to each device of a bus."""

    def __init__(self, name: str, ids: tuple[int, ...], goal: Block, lower: Ints, upper: Ints) -> None:
        """`lower`, `upper` (m,): ticks that may ever be sent. Raises ValueError where lower > upper."""
        self.lower, self.upper = np.array(lower, np.int64), np.array(upper, np.int64)
        if self.lower.shape != (len(ids),) or self.upper.shape != (len(ids),):
            raise ValueError(f"{name}: bounds of {len(ids)} devices needed, got {self.lower.shape}")
        if not (self.lower <= self.upper).all():
            raise ValueError(f"{name}: lower bounds {lower} must not be above upper bounds {upper}")
        self._name, self._ids = name, np.array(ids, np.uint8)
        self._packet = bytearray(sync_write(goal.address, {id: bytes(goal.size) for id in ids}))
        self._head = bytes(self._packet[:FIRST])
        self._all = np.frombuffer(self._packet, np.uint8, len(self._packet) - 2)
        self._goals = np.frombuffer(self._packet, ROW, len(ids), FIRST)["goal"]
        self._check = np.frombuffer(self._packet, "<u2", 1, len(self._packet) - 2)
        self._crc = Crc(len(self._packet) - 2)

    def encode(self, ticks: Ints) -> bytes:
        """The packet for goals (m,) in ticks, stuffed where needed. Raises WireClamp, ValueError (shape)."""
        if ticks.shape != self._ids.shape or ticks.dtype.kind != "i":
            raise ValueError(f"{self._name}: {len(self._ids)} whole ticks needed, got {ticks!r}")
        self._goals[:] = ticks
        if self._packet.find(PATTERN, BODY, -2) < 0:
            self._check[0] = self._crc(self._all)
            packet = plain = bytes(self._packet)
        else:
            packet = self._stuffed()
            plain = packet[:BODY] + unstuff(packet[BODY:-2])
        self._judge(plain, ticks)
        return packet

    def _stuffed(self) -> bytes:
        body = stuff(self._packet[BODY:-2])
        packet = self._head[:5] + (len(body) + 2).to_bytes(2, "little") + body
        crc = int(Crc(len(packet))(np.frombuffer(packet, np.uint8)))
        return packet + crc.to_bytes(2, "little")

    def _judge(self, plain: bytes, ticks: Ints) -> None:
        """What stands in the bytes, not what was meant: ids, address and every goal word."""
        rows = np.frombuffer(plain, ROW, len(self._ids), FIRST)
        words: NDArray[np.int32] = rows["goal"]
        right = (words == ticks) & (words >= self.lower) & (words <= self.upper) & (rows["id"] == self._ids)
        if np.count_nonzero(right) == len(right) and plain[BODY:FIRST] == self._head[BODY:]:
            return
        place = int(np.argmin(right))
        lower, upper = int(self.lower[place]), int(self.upper[place])
        raise WireClamp(self._name, int(self._ids[place]), int(ticks[place]), lower, upper)
