"""Goal packets, encoded in place each tick, then decoded from their bytes and checked (WIRE_CLAMP). Pure."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twind_drivers.bus import Ints, WireRangeError
from twind_drivers.dynamixel.crc import crc16
from twind_drivers.dynamixel.device_layout import RegisterBlock
from twind_drivers.dynamixel.packet import PATTERN, stuff, sync_write, unstuff
from twind_drivers.flags import some
from twind_drivers.half_duplex.goal_bounds import bounds_of

BODY = 7  # where INST begins
FIRST = 12  # where the first row begins


class GoalPacket:
    """Sync write of one goal, position, velocity or current, to each device of a bus."""

    def __init__(self, name: str, ids: Sequence[int], goal: RegisterBlock, lower: Ints, upper: Ints) -> None:
        """Make the packet; `lower`, `upper` (m,), raw: range of goals. Raises ValueError if lower > upper."""
        self.lower, self.upper = bounds_of(name, len(ids), lower, upper)
        self._name = name
        self._ids = bytes(ids)
        self._shape = (len(ids),)
        self._row = np.dtype([("id", "u1"), ("goal", f"<i{goal.size}")])
        self.packet = bytearray(sync_write(goal.address, {id: bytes(goal.size) for id in ids}))
        self._head = bytes(self.packet[:FIRST])
        self._all = memoryview(self.packet)[:-2]
        self._goals = np.frombuffer(self.packet, self._row, len(ids), FIRST)["goal"]
        self._span = (self.upper - self.lower).view(np.uint64)

    def encode(self, ticks: Ints) -> bytes:
        """Packet of goals (m,), stuffed if necessary. Raises WireRangeError, ValueError (shape)."""
        if ticks.shape != self._shape or ticks.dtype.kind != "i":
            raise ValueError(f"{self._name}: {len(self._ids)} whole ticks needed, got {ticks!r}")
        self._goals[:] = ticks
        if self.packet.find(PATTERN, BODY, -2) < 0:
            self.packet[-2:] = crc16(self._all).to_bytes(2, "little")
            packet = plain = bytes(self.packet)
            words = self._goals  # what `packet` is a copy of
        else:
            packet = self._stuffed()
            plain = packet[:BODY] + unstuff(packet[BODY:-2]) + packet[-2:]
            words = np.frombuffer(plain, self._row, len(ticks), FIRST)["goal"]
        self._judge(plain, words, ticks)
        return packet

    def _stuffed(self) -> bytes:
        body = stuff(self.packet[BODY:-2])
        packet = self._head[:5] + (len(body) + 2).to_bytes(2, "little") + body
        return packet + crc16(packet).to_bytes(2, "little")

    def _judge(self, plain: bytes, words: NDArray[np.signedinteger], ticks: Ints) -> None:
        """Check the encoded bytes: ids, address and each goal word. Raises WireRangeError.

        The bytes are decoded again, so that an error of the encoder cannot reach a servo.
        """
        # Below the lower bound a difference is negative, so as an unsigned number beyond every span.
        outside = (words - self.lower).view(np.uint64) > self._span
        if (
            not some(outside)
            and not some(words != ticks)
            and plain[FIRST : -2 : self._row.itemsize] == self._ids
            and plain[BODY:FIRST] == self._head[BODY:]
        ):
            return
        place = int(np.argmax(outside | (words != ticks)))
        lower = int(self.lower[place])
        upper = int(self.upper[place])
        raise WireRangeError(self._name, self._ids[place], int(ticks[place]), lower, upper)


class MixedGoals:
    """Goal packets of devices with different goal registers: one sync write for each (address, size)."""

    def __init__(
        self, name: str, ids: Sequence[int], goals: Sequence[RegisterBlock], lower: Ints, upper: Ints
    ) -> None:
        """Make the packets; `goals` (m): goal register of each id. Raises ValueError as `GoalPacket` does."""
        self.lower, self.upper = bounds_of(name, len(ids), lower, upper)
        self._name = name
        self._count = len(ids)
        self._parts: list[tuple[NDArray[np.intp], GoalPacket]] = []
        for goal in dict.fromkeys(goals):
            places = np.array([place for place, each in enumerate(goals) if each == goal])
            own = [ids[place] for place in places]
            packet = GoalPacket(name, own, goal, self.lower[places], self.upper[places])
            self._parts.append((places, packet))

    def encode(self, ticks: Ints) -> bytes:
        """The packets of goals (m,), one behind the other. Raises WireRangeError, ValueError (shape)."""
        if ticks.shape != (self._count,) or ticks.dtype.kind != "i":
            raise ValueError(f"{self._name}: {self._count} whole ticks needed, got {ticks!r}")
        return b"".join([packet.encode(ticks[places]) for places, packet in self._parts])


Goals = GoalPacket | MixedGoals


def goal_packets(
    name: str, ids: Sequence[int], goals: Sequence[RegisterBlock], lower: Ints, upper: Ints
) -> Goals:
    """Return the encoder of a bus's goals: one packet if all devices have the same goal register."""
    if len(set(goals)) == 1:
        return GoalPacket(name, ids, goals[0], lower, upper)
    return MixedGoals(name, ids, goals, lower, upper)
