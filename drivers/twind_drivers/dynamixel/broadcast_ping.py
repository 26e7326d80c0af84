"""Replies to a broadcast ping: all devices on the wire, in any order, garbled or not. Pure.

Devices reply in the order of their ids, each in its own time slot. Id 5 alone did not reply within 10 ms at
2 Mbaud, but within 50 ms (Dynamixel2Arduino #106). The vendor's tool allows 3 ms per id beside the wire time
(DynamixelSDK, `broadcastPing`). A broadcast ping of a robot takes tens of milliseconds, one of all ids most
of a second: it is for tools that own the port alone, never for a tick.
"""

from collections.abc import Sequence

import numpy as np

from twind_drivers.dynamixel.packet import LAST_ID, STATUS_OVERHEAD, Framer, Packet

SLOT = 0.003  # s per id beside its wire time (DynamixelSDK, `broadcastPing`); less misses high ids
SIZE = 3  # bytes: model number 2, firmware 1
ROOM = 4096  # bytes taken at once


class BroadcastPingReply:
    """Replies to one broadcast ping. Arrays are by id, (253,). Only the end of the window completes it.

    `last`: the highest id whose slot is inside the window.
    """

    def __init__(self, last: int = LAST_ID) -> None:
        """Make the reply. Raises ValueError for an id outside 0..252."""
        if not 0 <= last <= LAST_ID:
            raise ValueError(f"id {last} is not one of 0..{LAST_ID}: no device can have it")
        self.ids = tuple(range(LAST_ID + 1))
        self.size = SIZE
        self.slots = last + 1
        self.expected = self.slots * (STATUS_OVERHEAD + SIZE)
        self._buffer = memoryview(bytearray(ROOM))
        self._framer = Framer(status=True)
        self.heard = self.answered = np.zeros(len(self.ids), np.bool_)
        self.error = np.zeros(len(self.ids), np.uint8)
        self.data = np.zeros((len(self.ids), SIZE), np.uint8)
        self.strays = 0
        self.whole = False
        self.first = b""
        self.unasked: Sequence[Packet] = ()  # always empty: each status is a reply to a broadcast
        self.twice: set[int] = set()

    @property
    def window(self) -> float:
        """Time (s) of the slots of ids 0..`last`, beside the wire time."""
        return self.slots * SLOT

    def start(self) -> None:
        """Discard the previous result."""
        self.heard.fill(False)
        self.error.fill(0)
        self.data.fill(0)
        self.strays = 0
        self.twice.clear()
        self._framer.clear()
        self._framer.discarded = 0

    def receive_buffer(self) -> memoryview:
        """Return the buffer for the next bytes: always the same, so that a noisy line does not grow it."""
        return self._buffer

    def take(self, count: int) -> bool:
        """Process bytes; never complete: further devices may answer until the window ends."""
        for packet in self._framer.feed(self._buffer[:count]):
            self._accept(packet)
        return False

    def end(self) -> None:
        """Count the remaining bytes that form no status as stray."""
        self._framer.clear()
        self.strays += self._framer.discarded
        self._framer.discarded = 0

    def _accept(self, packet: Packet) -> None:
        if len(packet.data) != SIZE or self.heard[packet.id]:
            self.strays += len(packet.params) + STATUS_OVERHEAD - 1
            if len(packet.data) == SIZE:
                self.twice.add(packet.id)  # two devices with one id, one after the other
            return
        self.heard[packet.id] = True
        self.error[packet.id] = packet.error
        self.data[packet.id] = np.frombuffer(packet.data, np.uint8)
