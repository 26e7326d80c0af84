"""Group reads of the same block of many servos, as one numpy pass: plain and fast sync read.

A group is remembered with its request, so the next equal request costs no parsing. Both layouts by e-manual,
"Sync Read" and "Fast Sync Read".
"""

from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from twind_drivers.dynamixel.crc import Crc, crc16
from twind_drivers.dynamixel.packet import BROADCAST, HEADER, PATTERN, STATUS
from twind_drivers.virtual.servos import Servos
from twind_drivers.virtual.wire import Wire

Bytes = NDArray[np.uint8]


class PlainGroup:
    """One status per servo."""

    def __init__(
        self, servos: Servos, wire: Wire, rows: Sequence[int], ids: bytes, span: tuple[int, int]
    ) -> None:
        """`span`: address and size. All rows must hold it readably."""
        address, size = span
        length = 11 + size
        self._servos, self._rows = servos, servos.registers.selection(rows)
        self._cells = servos.memory.block(rows, address, size)
        self.live = servos.registers.live(rows, address, size)  # does it hold what changes by itself?
        self._out = np.zeros((len(rows), length), np.uint8)
        self._out[:, :4] = np.frombuffer(HEADER, np.uint8)
        self._out[:, 4] = np.frombuffer(ids, np.uint8)
        self._out[:, 5:7] = np.frombuffer((size + 4).to_bytes(2, "little"), np.uint8)
        self._out[:, 7] = STATUS
        self._crc = Crc(length - 2)
        self._check = self._out[:, -2:].view("<u2")[:, 0]
        delays = servos.registers.delays(rows)
        self.cuts = [length * (place + 1) for place in range(len(rows))]
        self.ends = wire.ends(delays, [length] * len(rows))

    def data(self) -> bytes | None:
        """All statuses; None when one of them needs stuffing, which changes its length."""
        out = self._out
        out[:, 8] = self._servos.alert[self._rows]
        out[:, 9:-2] = self._cells.get()
        self._check[:] = self._crc(out[:, :-2])
        raw = out.tobytes()
        return raw if raw.count(PATTERN) == len(out) else None


class FastGroup:
    """One joint status, unstuffed; the CRC of every block is over all bytes before it."""

    def __init__(
        self, servos: Servos, wire: Wire, rows: Sequence[int], ids: bytes, span: tuple[int, int], asked: int
    ) -> None:
        """`rows` are those that answer, the first ones of `asked`: behind a missing one all are silent."""
        address, size = span
        count, block = len(rows), 4 + size
        self._servos, self._rows = servos, servos.registers.selection(rows)
        self._cells = servos.memory.block(rows, address, size)
        self.live = servos.registers.live(rows, address, size)  # does it hold what changes by itself?
        lead = HEADER + bytes((BROADCAST,)) + (asked * block + 1).to_bytes(2, "little") + bytes((STATUS,))
        self._lead = lead
        self._blocks = np.zeros((count, block), np.uint8)
        self._blocks[:, 1] = np.frombuffer(ids, np.uint8)
        self._check = self._blocks[:, -2:].view("<u2")[:, 0]
        self._crc, self._carry = Crc(block - 2), carry(block - 2)
        self._lead_crc = crc16(lead + bytes(block - 2))  # what the lead contributes to the first block's CRC
        sizes = [len(lead) + block] + [block] * (count - 1)
        self.cuts = [len(lead) + block * (place + 1) for place in range(count)]
        self.ends = wire.ends([servos.registers.delays(rows[:1])[0]] + [0.0] * (count - 1), sizes)

    def data(self) -> bytes | None:
        """The reply; never None, a fast reply is not stuffed."""
        blocks, carry = self._blocks, self._carry
        blocks[:, 0] = self._servos.alert[self._rows]
        blocks[:, 2:-2] = self._cells.get()
        crc, *own = self._crc(blocks[:, :-2]).tolist()
        crc ^= self._lead_crc
        checks = [crc]
        for each in own:
            crc = carry[(crc ^ (crc >> 8)) & 0xFF] ^ each
            checks.append(crc)
        self._check[:] = checks
        return self._lead + blocks.tobytes()


@cache
def carry(size: int) -> list[int]:
    """What a CRC c contributes behind its own two bytes and `size` more, at [low(c) ^ high(c)].

    Feeding low(c), high(c) into the state c equals feeding x, x into the state 0, x = low ^ high (linearity).
    """
    rows = np.zeros((256, 2 + size), np.uint8)
    rows[:, 0] = rows[:, 1] = np.arange(256)
    table: list[int] = Crc(2 + size)(rows).tolist()
    return table
