"""Replies to requests: their form, and their search in untrusted bytes (RX_SHAPE). Pure: no I/O, no clock.

A reply owns one fixed buffer. The code that does the I/O reads into `receive_buffer()` and calls
`take(count)`; when done, or at the deadline, `end()`. Then `heard`, `error` and `data` hold the replies, in
the order of `ids`.
"""

from collections.abc import Sequence
from struct import Struct
from typing import Any

import numpy as np

from twind_drivers.dynamixel.crc import Crc, crc16, umts
from twind_drivers.dynamixel.packet import (
    BROADCAST,
    CAPACITY,
    HEADER,
    STATUS,
    STATUS_OVERHEAD,
    STUFFED,
    Framer,
    Packet,
)
from twind_drivers.flags import some

FAILED = 0x7F  # bits of the error byte: number of the reason of a failure; bit 7 is the alert (e-manual)


def _check_ids(ids: Sequence[int], expected: int) -> None:
    if expected > CAPACITY:
        raise ValueError(
            f"a reply of {len(ids)} devices would be {expected} bytes, more than {CAPACITY}: request fewer"
        )


def _row(stride: int) -> np.dtype[np.void]:
    """Return the record type of a status: its first 8 bytes as one number, the error byte, the CRC."""
    fields: Any = {
        "names": ["head", "error", "crc"],
        "formats": ["<u8", "u1", "<u2"],
        "offsets": [0, 8, stride - 2],
        "itemsize": stride,
    }
    row: np.dtype[np.void] = np.dtype(fields)
    return row


def _status_head(id: int, size: int) -> bytes:
    """Return the first 8 bytes of a status of `size` data bytes."""
    return HEADER + bytes((id,)) + (size + 4).to_bytes(2, "little") + bytes((STATUS,))


class StatusReply:
    """Reply of one status per device, `size` data bytes each: to a sync read, or to a single device.

    The usual case, all rows whole and none stuffed, is checked in a few numpy calls. Everything else (stuffed
    rows, a missing device, noise) goes through the framer.
    """

    def __init__(self, ids: Sequence[int], size: int) -> None:
        """Raises ValueError when the reply would not fit the buffer."""
        stride = STATUS_OVERHEAD + size
        self.ids = tuple(ids)
        self.size = size
        self.expected = len(ids) * stride
        _check_ids(ids, self.expected)
        self._bytes = bytearray(CAPACITY)
        self._view = memoryview(self._bytes)
        self._rows = np.frombuffer(self._bytes, np.uint8, self.expected).reshape(len(ids), stride)
        self._records = np.frombuffer(self._bytes, _row(stride), len(ids))
        self._head = np.frombuffer(b"".join(_status_head(id, size) for id in ids), "<u8")
        self._crc = Crc(stride - 2)
        self._index = {id: place for place, id in enumerate(ids)}
        self._spare = np.zeros((len(ids), size), np.uint8)
        self._framer = Framer(status=None)
        self._heads, self._crcs, self._errors = (self._records[name] for name in ("head", "crc", "error"))
        self._checked = self._rows[:, :-2]
        self._blocks = self._rows[:, 9:-2]
        self.heard, self.answered = np.zeros((2, len(ids)), np.bool_)
        self.unasked: Sequence[Packet] = ()
        self.error = np.zeros(len(ids), np.uint8)
        self.data = self._spare
        self.start()

    def start(self) -> None:
        """Discard the previous reply."""
        self._got = self.strays = 0
        self._framing = self.whole = False
        self.first = b""
        self.heard.fill(False)
        self.answered.fill(False)
        if self.unasked:
            self.unasked = ()

    def receive_buffer(self) -> memoryview:
        """Return the buffer for the next bytes."""
        return self._view if self._framing else self._view[self._got :]

    def take(self, count: int) -> bool:
        """Process `count` bytes; they are checked only once the reply may be complete."""
        if self._framing:
            return self._frame(count)
        self._got += count
        if self._got < self.expected:
            return False
        return self._is_complete() or self._reframe()

    def end(self) -> None:
        """Settle the result."""
        if not (self.whole or self._framing):
            self._reframe()
        if self._framing:
            self._framer.clear()
            self.strays += self._framer.discarded
            self.whole = bool(self.heard.all())

    def _is_complete(self) -> bool:
        """Return True if all rows are present, in order and intact; bytes behind them are stray."""
        if some(self._heads != self._head) or self._bytes.find(STUFFED, 0, self.expected) >= 0:
            return False
        if some(self._crcs != self._crc(self._checked)):
            return False
        error = self._errors.copy()
        if self.size and some(error) and some(error & FAILED):
            return False
        if self._got > self.expected:
            self._take_rest()
        self.heard.fill(True)
        self.answered.fill(True)
        self.error = error
        self.data = self._blocks
        self.whole = True
        return True

    def _take_rest(self) -> None:
        """Take the bytes behind the last row."""
        self.strays = self._got - self.expected
        self.unasked = tuple(self._framer.feed(self._view[self.expected : self._got]))
        self._framer.clear()

    def _reframe(self) -> bool:
        """Pass the buffer and all later bytes through the framer."""
        self._framing = True
        self.first = bytes(self._view[: self._got])
        self._spare.fill(0)
        self.error = np.zeros(len(self.ids), np.uint8)
        self.data = self._spare
        self._framer.discarded = 0
        return self._frame(self._got)

    def _frame(self, count: int) -> bool:
        for packet in self._framer.feed(self._view[:count]):
            self._accept(packet)
        return bool(self.answered.all())

    def _accept(self, packet: Packet) -> None:
        """Accept a status of the exact id and length of this request, once; count any other packet as stray.

        An error may come without data. Data that come with an error number are no reading: the error reports
        that the device did not execute the request.
        """
        place = self._index.get(packet.id) if packet.instruction == STATUS else None
        failed = packet.error & FAILED != 0
        whole = len(packet.data) == self.size and not (failed and self.size)
        refused = failed and len(packet.data) in (0, self.size)
        if place is None or self.answered[place] or not (whole or refused):
            self.strays += packet.octets
            self.unasked = (*self.unasked, packet)
            return
        self.answered[place] = True
        self.error[place] = packet.error
        if whole:
            self.heard[place] = True
            self._spare[place] = np.frombuffer(packet.data, np.uint8)


class FastSyncReadReply:
    """Common status of a fast sync read: not stuffed, each block's CRC covers all bytes before it.

    A missing device ends the reply (e-manual, "Fast Sync Read"). The intact prefix is kept: blocks up to the
    first whose CRC is wrong. The last CRC alone proves nothing: each device computes its own over the bytes
    that it received, so what was garbled for all (two devices of one id) still ends in a right one. Data of a
    device that reports an error number are dropped. A whole status of another device in the middle of the
    reply is taken out.
    """

    def __init__(self, ids: Sequence[int], size: int) -> None:
        """Raises ValueError when the reply would not fit the buffer."""
        count = len(ids)
        stride = size + 4
        self.ids = tuple(ids)
        self.size = size
        self.expected = 8 + count * stride
        _check_ids(ids, self.expected)
        length = (count * stride + 1).to_bytes(2, "little")
        self._head = HEADER + bytes((BROADCAST,)) + length + bytes((STATUS,))
        self._bytes = bytearray(CAPACITY)
        self._view = memoryview(self._bytes)
        self._rows = np.frombuffer(self._bytes, np.uint8, count * stride, 8).reshape(count, stride)
        ends = [8 + (place + 1) * stride - 2 for place in range(count)]
        self._covered = [self._view[:end] for end in ends]  # by the CRC of each block
        self._unpack_crcs = Struct(f"<8x{f'{size + 2}xH' * count}").unpack_from
        self._wanted = bytes(self.ids)
        self._stride = stride
        self.heard = self.answered = np.zeros(count, np.bool_)
        self.error = np.zeros(count, np.uint8)
        self.data = self._rows[:, 2:-2]
        self._errors = self._rows[:, 0]
        self._framer = Framer(status=None)  # for bytes that are no part of the reply
        self.unasked: Sequence[Packet] = ()
        self.start()

    def start(self) -> None:
        """Discard the previous reply."""
        self._got = self.strays = 0
        self._settled = self.whole = False
        self.first = b""
        self.heard.fill(False)
        self.answered = self.heard
        if self.unasked:
            self.unasked = ()

    def receive_buffer(self) -> memoryview:
        """Return the buffer for the next bytes."""
        return self._view[self._got :]

    def take(self, count: int) -> bool:
        """Process `count` bytes; they are checked only once the reply may be complete."""
        self._got += count
        return self._got >= self.expected and self._settle(final=False)

    def end(self) -> None:
        """Settle the result: the intact prefix."""
        if not self._settled:
            self._settle(final=True)

    def _settle(self, *, final: bool) -> bool:
        while True:
            at = self._bytes.find(self._head, 0, self._got)
            self._shift(at if at >= 0 else max(0, self._got - (0 if final else len(self._head) - 1)))
            if at < 0 and final:
                return self._keep(0)
            if at < 0 or (self._got < self.expected and not final):
                return False
            count = self._intact()
            if count < len(self.ids):
                if self._cut_out():
                    continue
                if not final and self._interrupted():
                    return False  # the rest of both may still come
            if count:
                return self._keep(count)
            self._shift(1)  # a false head

    def _interrupted(self) -> bool:
        """Return True if another packet lies in between: a second header, or the first bytes of one."""
        begins = any(self._view[self._got - n : self._got] == HEADER[:n] for n in range(1, len(HEADER)))
        return begins or self._bytes.find(HEADER, len(HEADER), self._got) >= 0

    def _cut_out(self) -> bool:
        """Take out the first whole status behind the head; return False if there is none."""
        at = self._bytes.find(HEADER, len(HEADER), self._got)
        while at >= 0:
            end = at + 7 + int.from_bytes(self._view[at + 5 : at + 7], "little")
            if end <= self._got and Framer(status=True).feed(self._view[at:end]):
                self._drop(at, end)
                self._bytes[at : self._got - (end - at)] = self._bytes[end : self._got]
                self._got -= end - at
                return True
            at = self._bytes.find(HEADER, at + 1, self._got)
        return False

    def _shift(self, count: int) -> None:
        """Drop the first `count` bytes, which are no part of the reply."""
        if count:
            self._drop(0, count)
            self._bytes[: self._got - count] = self._bytes[count : self._got]
            self._got -= count

    def _drop(self, first: int, end: int) -> None:
        if not (first or self.strays):
            self.first = bytes(self._view[:end])
        self.strays += end - first
        self.unasked = (*self.unasked, *self._framer.feed(self._view[first:end]))

    def _intact(self) -> int:
        """Return the number of intact blocks from the first."""
        there = self._bytes[9 : self.expected : self._stride] if self._got >= self.expected else b""
        if there == self._wanted and tuple(map(umts, self._covered)) == self._unpack_crcs(self._bytes):
            return len(self.ids)
        place = 0
        while self._is_intact(place):
            place += 1
        return place

    def _is_intact(self, place: int) -> bool:
        """Return True if that block is there with its id and CRC. Never True for all of them here."""
        end = 8 + (place + 1) * self._stride
        if end > self._got or self._bytes[end - self._stride + 1] != self.ids[place]:
            return False
        return crc16(self._view[: end - 2]) == int.from_bytes(self._view[end - 2 : end], "little")

    def _keep(self, count: int) -> bool:
        self._settled = True
        self.whole = count == len(self.ids)
        used = 8 + count * (self.size + 4)
        if used < self._got:
            self._drop(used, self._got)
        if self.strays:
            self._framer.clear()
        self.heard[:count] = True
        if not self.whole:
            self._rows[count:] = 0
        self.error = self._errors.copy()
        if some(self.error):
            self._leave_out_failed()
        return True

    def _leave_out_failed(self) -> None:
        """Drop the data of devices that reported an error number."""
        failed = (self.error & FAILED) != 0
        if failed.any():
            self.whole = False
            self.answered = self.heard.copy()
            self.heard[failed] = False
            self._rows[failed] = 0
