"""Group reads of the same block of many servos in one numpy pass: plain and fast sync read.

A group is remembered with its request, so the next equal request costs no parsing. Both layouts by e-manual,
"Sync Read" and "Fast Sync Read".
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from fastcrc.crc16 import umts

from twind_drivers.dynamixel.crc import Crc
from twind_drivers.dynamixel.packet import BROADCAST, HEADER, PATTERN, STATUS
from twind_drivers.virtual.half_duplex_wire import HalfDuplexWire
from twind_drivers.virtual.virtual_servos import VirtualServos

# The CRC behind its own two bytes, at [low ^ high]: low, high fed into the state low | high << 8 are as
# low ^ high twice fed into 0 (linearity).
AFTER_ITSELF = tuple(umts(bytes((mixed, mixed))) for mixed in range(256))


class SyncReadGroup:
    """One status per servo."""

    def __init__(
        self,
        servos: VirtualServos,
        wire: HalfDuplexWire,
        rows: Sequence[int],
        ids: bytes,
        span: tuple[int, int],
    ) -> None:
        """`span`: address and size. All rows must hold it readably."""
        address, size = span
        length = 11 + size
        self._servos = servos
        self._rows = servos.registers.selection(rows)
        self._cells = servos.memory.block(rows, address, size)
        self.live = servos.registers.has_measured_registers(rows, address, size)
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


class FastSyncReadGroup:
    """One joint status, unstuffed; the CRC of every block is over all bytes before it."""

    def __init__(
        self,
        servos: VirtualServos,
        wire: HalfDuplexWire,
        rows: Sequence[int],
        ids: bytes,
        span: tuple[int, int],
        asked: int,
    ) -> None:
        """Make the read; `rows`: those that reply, the first of `asked`; a missing one silences the rest."""
        address, size = span
        count = len(rows)
        block = 4 + size
        self._servos = servos
        self._rows = servos.registers.selection(rows)
        self._cells = servos.memory.block(rows, address, size)
        self.live = servos.registers.has_measured_registers(rows, address, size)
        lead = HEADER + bytes((BROADCAST,)) + (asked * block + 1).to_bytes(2, "little") + bytes((STATUS,))
        self.cuts = [len(lead) + block * (place + 1) for place in range(count)]
        self.ends = wire.ends(
            [servos.registers.delays(rows[:1])[0]] + [0.0] * (count - 1),
            [self.cuts[0]] + [block] * (count - 1),
        )
        self._reply = np.zeros(self.cuts[-1], np.uint8)
        self._reply[: len(lead)] = np.frombuffer(lead, np.uint8)
        self._blocks = self._reply[len(lead) :].reshape(count, block)
        self._blocks[:, 1] = np.frombuffer(ids, np.uint8)
        self._check = self._blocks[:, -2:].view("<u2")[:, 0]
        reply = self._reply.data
        self._shares = [reply[first : last - 2] for first, last in pairwise((0, *self.cuts))]

    def data(self) -> bytes | None:
        """The reply; never None, a fast reply is not stuffed."""
        self._blocks[:, 0] = self._servos.alert[self._rows]
        self._blocks[:, 2:-2] = self._cells.get()
        crc = 0
        checks = []
        for share in self._shares:
            crc = umts(share, AFTER_ITSELF[(crc ^ crc >> 8) & 0xFF])
            checks.append(crc)
        self._check[:] = checks
        return self._reply.tobytes()
