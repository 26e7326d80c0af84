"""Faults of single replies on their way to the host: lost, flipped, cut, doubled, late."""

from collections.abc import Sequence
from typing import NamedTuple

from twind_drivers.dynamixel.packet import HEADER, LAST_ID, status
from twind_drivers.virtual.fault_orders import FaultOrders
from twind_drivers.virtual.faulty_byte_stream import FaultyByteStream
from twind_drivers.virtual.half_duplex_wire import HalfDuplexWire


class FaultedReply(NamedTuple):
    """Bytes and delay of one answer after its faults."""

    before: bytes  # comes first
    data: bytes
    after: bytes  # comes behind
    late: float  # s
    ended: bool  # no further servo continues this common reply


class ReplyFaults(FaultOrders):
    """Faults of the next answers: what one device sends, its status or its part of a joint (fast) one."""

    def __init__(self, wire: HalfDuplexWire, stream: FaultyByteStream) -> None:
        super().__init__()
        self._wire = wire
        self.stream = stream

    def corrupt(self, count: int, id: int | None = None, bits: int = 1) -> None:
        """Flip so many bits in each of the next answers. Raises ValueError, KeyError."""
        if not 1 <= bits <= 64:
            raise ValueError(f"corrupt: {bits} bits are outside 1..64")
        self._order("corrupt", count, id, bits)

    def forge(self, count: int, id: int | None = None) -> None:
        """Replace each of the next answers by a sound one of id 252, or by one that is a byte short."""
        self._order("forge", count, id)

    def cut(self, count: int, bytes: int, id: int | None = None) -> None:
        """Cut each of the next `count` answers after `bytes` bytes; a joint (fast) answer ends there.

        Raises ValueError for a negative size.
        """
        if bytes < 0:
            raise ValueError(f"cut: {bytes} bytes: a size is 0 or more")
        self._order("cut", count, id, bytes)

    def noise(self, seconds: float, count: int = 0, id: int | None = None) -> None:
        """Send random bytes for so long: now, or (count above 0) before each of the next answers.

        Raises ValueError outside 0..10 s.
        """
        if not 0.0 <= seconds <= 10.0:
            raise ValueError(f"noise: {seconds} s are outside 0..10 s")
        if count or id is not None:
            self._order("noise", count, id, seconds)
        else:
            self.stream.noise_left = seconds
            self.stream.look()

    def delay(self, seconds: float, id: int | None = None) -> None:
        """Delay every answer (of one id) by so much, until set to 0; other devices' answers are not delayed.

        Exception: behind a part of a joint (fast) answer the later parts wait. Raises ValueError outside
        0..10 s, KeyError.
        """
        self._delay(seconds, id)
        if id is None:  # on the wire, where a chain of answers stays together
            self._wire.lag = self._late.pop(None)
            self.look()

    def look(self) -> None:
        """Update whether any answer is to be changed, or may meet another. To call after every change."""
        super().look()
        self.active = self.active or self.stream.colliding

    def clear(self) -> None:
        """Remove all reply faults."""
        self._wire.lag = 0.0
        super().clear()

    def speak(
        self, ids: Sequence[int], delays: Sequence[float], pieces: Sequence[bytes], joint: bool
    ) -> None:
        """Send the devices' answers one after the other, each with its faults. Delays in s."""
        wire = self._wire
        at = wire.free_at(float("-inf"))
        for id, delay, piece in zip(ids, delays, pieces, strict=True):
            struck = self._strike(id, piece)
            held, late = (struck.late, 0.0) if joint else (0.0, struck.late)  # a chain waits for its links
            at += (delay if wire.timing else 0.0) + held + wire.span(len(struck.before))
            self._put(at, struck.before, 0.0)
            at += wire.span(len(piece))
            self._put(at, struck.data, late)
            at += wire.span(len(struck.after))
            self._put(at, struck.after, late)
            if joint and struck.ended:
                break
        wire.occupy(at)
        self.look()

    def _put(self, end: float, data: bytes, late: float) -> None:
        """Put bytes on the wire: the last of them comes `late` s after `end` (s)."""
        end += late + self._wire.lag
        start = end - self._wire.span(len(data))
        if data and not (self.stream.colliding and self._wire.collide(start, data)):
            self._wire.interject(end, data)

    def _strike(self, id: int, piece: bytes) -> FaultedReply:
        late = self._late.get(id, 0.0)
        if self._hit("drop", id) is not None:
            return FaultedReply(b"", b"", b"", late, False)
        data = piece
        before = b""
        after = b""
        if self._hit("forge", id) is not None:
            data = self._forged(id, data)
        bits = self._hit("corrupt", id)
        if bits is not None:
            data = self._corrupted(data, int(bits))
        size = self._hit("cut", id)
        if size is not None:
            data = data[: int(size)]
        if self._hit("duplicate", id) is not None:
            after = data
        if self._hit("foreign", id) is not None:
            before = self._status(LAST_ID, b"\0\0\0\0")
        seconds = self._hit("noise", id)
        if seconds is not None:
            before = self.stream.noise(seconds) + before
        return FaultedReply(before, data, after, late, size is not None)

    def _forged(self, id: int, piece: bytes) -> bytes:
        """Return a separate status with a right CRC: of an id without a request, or a byte short."""
        data = self._payload(piece)
        if self.stream.random.random() < 0.5:
            return self._status(LAST_ID, data)
        return self._status(id, data[:-1])

    def _status(self, id: int, data: bytes) -> bytes:
        """Build a sound status in the protocol of the line."""
        return status(id, 0, data)

    def _payload(self, piece: bytes) -> bytes:
        """Return the data of a whole status or of a part of a joint one."""
        return piece[9:-2] if piece.startswith(HEADER) else piece[2:-2]

    def _corrupted(self, piece: bytes, bits: int) -> bytes:
        """Return the data with flipped bits: one in the middle, or several anywhere."""
        data = bytearray(piece)
        if bits == 1:
            data[len(data) // 2] ^= 0x10
            return bytes(data)
        for at in self.stream.random.choice(len(data) * 8, min(bits, len(data) * 8), replace=False):
            data[at // 8] ^= 1 << at % 8
        return bytes(data)
