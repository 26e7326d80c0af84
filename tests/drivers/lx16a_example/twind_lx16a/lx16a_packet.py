"""LX-16A packets, both directions, and the reply to reads. Pure.

`55 55 | ID | LEN | CMD | params | CHK`; LEN = params + 3, CHK = NOT(sum from ID on). A read and its reply
have one command; only the reply has params. Writes have no reply, and no reply reports an error. Source:
LewanSoul bus servo communication protocol.
"""

from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple

import numpy as np

HEADER = b"\x55\x55"
OVERHEAD = 6  # bytes of a packet without params
LAST_ID = 253


class LxCommand(IntEnum):
    """Commands in use. A read has the name of what it reads."""

    MOVE = 1  # position, time in ms
    GOAL = 2
    OFFSET = 19
    LIMITS = 21
    HEAT_LIMIT = 25
    TEMPERATURE = 26
    VOLTAGE = 27
    POSITION = 28
    MODE = 30
    LOAD = 31  # torque switch
    LOADED = 32


SIZES = {  # data bytes of the reply to each read
    LxCommand.GOAL: 4,
    LxCommand.OFFSET: 1,
    LxCommand.LIMITS: 4,
    LxCommand.HEAT_LIMIT: 1,
    LxCommand.TEMPERATURE: 1,
    LxCommand.VOLTAGE: 2,
    LxCommand.POSITION: 2,
    LxCommand.MODE: 4,
    LxCommand.LOADED: 1,
}


def lx_packet(id: int, code: int, params: bytes = b"") -> bytes:
    """Build a packet of either direction."""
    body = bytes((id, len(params) + 3, code)) + params
    return HEADER + body + bytes((~sum(body) & 0xFF,))


class LxPacket(NamedTuple):
    """Whole packet with a right checksum."""

    id: int
    code: int
    data: bytes

    @property
    def is_status(self) -> bool:
        """True for a reply: a command that reads, with data."""
        return self.code in SIZES and bool(self.data)

    @property
    def octets(self) -> int:
        """Bytes of the packet on the wire."""
        return len(self.data) + OVERHEAD


def find_lx_packets(data: bytes | bytearray | memoryview, *, status: bool | None = None) -> list[LxPacket]:
    """Return the whole sound packets in `data`, in order; `status` True: replies alone, False: the others."""
    raw = bytes(data)
    found: list[LxPacket] = []
    start = raw.find(HEADER)
    while 0 <= start <= len(raw) - OVERHEAD:
        end = start + raw[start + 3] + 3
        sound = raw[start + 3] >= 3 and end <= len(raw) and sum(raw[start + 2 : end]) & 0xFF == 0xFF
        if sound:
            found.append(LxPacket(raw[start + 2], raw[start + 4], raw[start + 5 : end - 1]))
        start = raw.find(HEADER, end if sound else start + 1)
    return [each for each in found if status is None or each.is_status is status]


class LxReply:
    """Replies of `ids` to reads of one command (`PendingReply`): each once, with its command and length."""

    def __init__(self, ids: Sequence[int], code: int, size: int) -> None:
        self.ids = tuple(ids)
        self.size = size
        self.expected = (OVERHEAD + size) * len(self.ids)
        self._code = code
        self._bytes = bytearray(4096)
        self.heard = np.zeros(len(self.ids), np.bool_)
        self.answered = self.heard
        self.error = np.zeros(len(self.ids), np.uint8)
        self.data = np.zeros((len(self.ids), size), np.uint8)
        self.start()

    def start(self) -> None:
        """Discard the previous reply."""
        self._got = 0
        self._lost = 0
        self.strays = 0
        self.whole = False
        self.first = b""
        self.unasked: Sequence[LxPacket] = ()
        self.heard.fill(False)

    def receive_buffer(self) -> memoryview:
        """Return the buffer for the next bytes."""
        if self._got == len(self._bytes):
            self._lost += self._got
            self._got = 0
        return memoryview(self._bytes)[self._got :]

    def take(self, count: int) -> bool:
        """Process `count` bytes; True when every device has answered."""
        self._got += count
        self.end()
        return self.whole

    def end(self) -> None:
        """Settle the result."""
        self.heard.fill(False)
        self.data.fill(0)
        used = 0
        rest: list[LxPacket] = []
        for each in find_lx_packets(memoryview(self._bytes)[: self._got]):
            place = self.ids.index(each.id) if each.id in self.ids else -1
            right = each.code == self._code and len(each.data) == self.size
            if place < 0 or not right or self.heard[place]:
                rest.append(each)
                continue
            self.heard[place] = True
            self.data[place] = np.frombuffer(each.data, np.uint8)
            used += each.octets
        self.unasked = rest
        self.strays = self._got - used + self._lost
        self.whole = bool(self.heard.all())
        self.first = bytes(self._bytes[: self._got]) if self.strays or not self.whole else b""
