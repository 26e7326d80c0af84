"""Status packets: what the servos have said, so what the daemon may have seen. Noise is passed over."""

from collections.abc import Iterator

import numpy as np

from tests.proof.busmon.crc import crc16
from tests.proof.busmon.packet import BROADCAST, HEADER, STATUS, Malformed, unstuff
from tests.proof.busmon.requests import FAST, Request

MOST = 4096  # bytes kept of an answer that does not end


class Ear:
    """Collects the answer to one request at a time."""

    def __init__(self) -> None:
        self.request: Request | None = None
        self.asked = -np.inf  # s
        self.bytes = 0  # that came since
        self.heard: set[int] = set()
        self._buffer = b""

    def ask(self, request: Request | None, now: float) -> None:
        """From now on this is what answers belong to."""
        self.request = request
        self.asked = now
        self.bytes = 0
        self.heard = set()
        self._buffer = b""

    @property
    def done(self) -> bool:
        """Nothing more is to come."""
        request = self.request
        return (
            request is None
            or not request.expected
            or self.bytes >= request.expected
            or self.heard.issuperset(request.reads or (request.id,))
        )

    def whole(self, data: bytes) -> "np.ndarray | None":
        """The short way: `data` is all of a fast answer that carries positions; its blocks."""
        request = self.request
        if request is None or request.uniform is None or self._buffer or len(data) != request.expected:
            return None
        if data[:8] != HEADER + b"\xfe" + (len(data) - 7).to_bytes(2, "little") + b"\x55":
            return None
        if crc16(data[:-2]) != data[-2] | data[-1] << 8:
            return None
        blocks = np.frombuffer(data, request.uniform, len(request.reads), 8)
        if blocks["id"].tobytes() != bytes(request.reads):
            return None
        self.bytes = len(data)
        return blocks

    def take(self, data: bytes) -> Iterator[tuple[int, int, int, bytes]]:
        """(id, error, address, data) of each sound status in what came."""
        self.bytes += len(data)
        if self.request is None:
            return
        buffer = (self._buffer + data)[-MOST:]
        at = 0
        fast = self.request.instruction in FAST
        while (found := buffer.find(HEADER, at)) >= 0:
            at = found
            if len(buffer) - found < 8:
                break
            length = buffer[found + 5] | buffer[found + 6] << 8
            end = found + 7 + length
            if not 4 <= length <= self.request.expected + 64 or buffer[found + 7] != STATUS:
                at += 4  # no header of what was asked for
                continue
            if fast and buffer[found + 4] == BROADCAST:
                yield from self._blocks(buffer[found:end])
            if len(buffer) < end:
                break
            sound = crc16(buffer[found : end - 2]) == buffer[end - 2] | buffer[end - 1] << 8
            if sound and not fast:
                yield from self._status(buffer[found:end])
            at = end if sound else found + 4
        self._buffer = buffer[at:]

    def _status(self, packet: bytes) -> Iterator[tuple[int, int, int, bytes]]:
        assert self.request is not None
        try:
            body = unstuff(packet[7:-2])
        except Malformed:
            return
        id = packet[4]
        error = body[1]
        data = body[2:]
        span = self.request.reads.get(id)
        self.heard.add(id)
        if span is not None and len(data) == span[1]:
            yield id, error, span[0], data

    def _blocks(self, answer: bytes) -> Iterator[tuple[int, int, int, bytes]]:
        """Blocks of a joint answer, each proved by the CRC over all before it; the rest is not believed."""
        assert self.request is not None
        at = 8
        length = self.request.expected
        sound = len(answer) == length and crc16(answer[:-2]) == answer[-2] | answer[-1] << 8
        for id, (address, size) in self.request.reads.items():
            end = at + size + 4
            if len(answer) < end or answer[at + 1] != id:
                return
            if not sound and crc16(answer[: end - 2]) != answer[end - 2] | answer[end - 1] << 8:
                return
            if id not in self.heard:
                self.heard.add(id)
                yield id, answer[at], address, answer[at + 2 : end - 2]
            at = end
