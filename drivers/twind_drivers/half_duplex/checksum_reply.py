"""Replies of the framing `FF FF`, found in untrusted bytes. Pure: no I/O, no clock.

Plain loops: for up to some 24 devices they are faster than numpy calls.
"""

from collections.abc import Sequence

import numpy as np

from twind_drivers.half_duplex.checksum_packet import (
    HEADER,
    OVERHEAD,
    ChecksumPacket,
    find_packets,
    is_sound,
)
from twind_drivers.half_duplex.pending_reply import Octets

CAPACITY = 4096  # bytes, more than a line of 1 Mbaud brings in 40 ms


class ChecksumReply:
    """One status of `size` data bytes per device (`PendingReply`): to a sync read or to single reads.

    A status is accepted once, of an id of this request, with exactly its length. An error byte beside data is
    the state of the servo; the data are valid. A packet equal to one of `requests` is its echo. `refusals`: a
    status with an error and without data is an answer, too.
    """

    def __init__(
        self, ids: Sequence[int], size: int, requests: Sequence[bytes] = (), *, refusals: bool = False
    ) -> None:
        stride = OVERHEAD + size
        self.ids = tuple(ids)
        self.size = size
        self.expected = stride * len(self.ids)
        self._requests = frozenset(requests)
        self._chained = len(requests) > 1
        self._refusals = refusals and size > 0
        self._bytes = bytearray(CAPACITY)
        self._view = memoryview(self._bytes)
        self._stride = stride
        self._heads = [HEADER + bytes((id, size + 2)) for id in self.ids]
        self._index = {id: place for place, id in enumerate(self.ids)}
        rows = np.frombuffer(self._bytes, np.uint8, self.expected).reshape(len(self.ids), stride)
        self._blocks = rows[:, 5:-1]
        self._errors = rows[:, 4]
        self._spare = np.zeros((len(self.ids), size), np.uint8)
        self.heard = np.zeros(len(self.ids), np.bool_)
        self.answered = np.zeros(len(self.ids), np.bool_) if self._refusals else self.heard
        self.error: Octets = np.zeros(len(self.ids), np.uint8)
        self.data: Octets = self._spare
        self.unasked: Sequence[ChecksumPacket]
        self.start()

    def start(self) -> None:
        """Discard the previous reply."""
        self._got = self.strays = 0
        self._lost = 0  # bytes of a full buffer that were dropped
        self._complete = self.whole = False
        self.first = b""
        self.unasked = ()
        self.heard.fill(False)
        self.answered.fill(False)

    def receive_buffer(self) -> memoryview:
        """Return the buffer for the next bytes."""
        if self._got == CAPACITY:
            self._lost += self._got
            self._got = 0
        return self._view[self._got :]

    def take(self, count: int) -> bool:
        """Process `count` bytes; True when every device has answered."""
        self._got += count
        if self._got < self.expected and not self._chained:
            return False
        if self._got == self.expected and not self._requests and self._is_complete():
            return True
        self._search()
        self._complete = bool(self.heard.all())
        return self._complete

    def end(self) -> None:
        """Settle the result."""
        if not self._complete:
            self._search()
        self.whole = bool(self.heard.all())
        if not self.whole or self.strays:
            self.first = bytes(self._view[: self._got])

    def _is_complete(self) -> bool:
        """Return True if all rows are there, in order and intact, and nothing else; none may be an echo."""
        data = self._bytes
        stride = self._stride
        at = 0
        for head in self._heads:
            if not data.startswith(head, at) or not is_sound(data, at, at + stride):
                return False
            at += stride
        self.error = self._errors.copy()
        self.data = self._blocks
        self.heard.fill(True)
        self.answered.fill(True)
        self.strays = self._lost  # an earlier search of a buffer that is dropped left its statuses out
        self.unasked = ()
        self._complete = True
        return True

    def _search(self) -> None:
        """Find the statuses in all bytes received so far; what is left over is stray."""
        self.heard.fill(False)
        self._spare.fill(0)
        self.error = np.zeros(len(self.ids), np.uint8)
        self.data = self._spare
        unasked: list[ChecksumPacket] = []
        data = self._bytes
        used = rest = 0
        at = data.find(HEADER, 0, self._got)
        while 0 <= at <= self._got - self._stride:
            end = at + self._stride
            place = self._index.get(data[at + 2])
            fits = data[at + 3] == self.size + 2 and is_sound(data, at, end)
            if place is None or not fits or self.heard[place] or bytes(data[at:end]) in self._requests:
                at = data.find(HEADER, at + 1, self._got)
                continue
            self.heard[place] = True
            self.error[place] = data[at + 4]
            self._spare[place] = np.frombuffer(data, np.uint8, self.size, at + 5)
            if at > rest:
                unasked += find_packets(self._view[rest:at])
            used += self._stride
            rest = end
            at = data.find(HEADER, end, self._got)
        unasked += find_packets(self._view[rest : self._got])
        self.unasked = self._take_refusals(unasked) if self._refusals else unasked
        self.strays = self._got - used + self._lost - OVERHEAD * (len(unasked) - len(self.unasked))

    def _take_refusals(self, packets: Sequence[ChecksumPacket]) -> list[ChecksumPacket]:
        """Record each status with an error alone as an answer; return the other packets."""
        self.answered[:] = self.heard
        others = []
        for each in packets:
            place = self._index.get(each.id)
            if place is None or self.answered[place] or each.data or not each.code:
                others.append(each)
            else:
                self.answered[place] = True
                self.error[place] = each.code
        return others
