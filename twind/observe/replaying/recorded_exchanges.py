"""The bytes of one serial bus as exchanges: the request, the bytes received and when, the replies. Pure.

Answers are found by the driver's own parsers (`dynamixel/replies.py`), so bytes that a daemon would have
dropped do not count as a reply.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from twind.flight import EntryKind, FlightEntry
from twind_drivers.dynamixel.packet import (
    BROADCAST,
    HEADER,
    OVERHEAD,
    Framer,
    Instruction,
    Packet,
)
from twind_drivers.dynamixel.replies import FastSyncReadReply, StatusReply
from twind_drivers.half_duplex.pending_reply import PendingReply

FAST = frozenset({Instruction.FAST_SYNC_READ, Instruction.FAST_BULK_READ})
QUESTIONS = frozenset(
    {Instruction.PING, Instruction.READ, Instruction.SYNC_READ, Instruction.BULK_READ, *FAST}
)
PINGED = 3  # bytes of a ping reply: model number 2, firmware 1
FIRMWARE = 6  # address of the latter; the former's is 0
THROWN = 0.0002  # s before the next request: bytes that were waiting then came at an unknown earlier time
PAUSE = 0.004  # s without a byte, after which even what completes an answer was too late for it


class DeviceReply(NamedTuple):
    """One reply of one device."""

    id: int
    error: int
    address: int  # -1: nothing but the error
    data: bytes


class RegisterAccess(NamedTuple):
    """A read or a write of one device."""

    id: int
    address: int
    data: bytes  # of a write; of a read as many zeros


@dataclass(frozen=True, slots=True)
class RecordedExchange:
    """One write of the host, and all bytes received until the next write."""

    time: float  # s, when it left
    asks: bytes  # the packet that asks; empty: none did
    writes: tuple[RegisterAccess, ...]
    answers: tuple[tuple[float, bytes], ...]  # s after `time`
    whole: bool  # all that was asked for is among them
    told: tuple[DeviceReply, ...]
    missed: tuple[int, ...]  # ids without a valid reply; unknown behind a gap


class RequestParser:
    """One request packet and the parser of its answers; kept, since the same request is sent repeatedly."""

    def __init__(self, packet: Packet) -> None:
        """Raises ValueError: the packet requests nothing that one bus could answer."""
        self.fast = packet.instruction in FAST
        self.ping = packet.instruction == Instruction.PING
        self.spans = tuple(_register_accesses(packet))
        sizes = {len(span.data) for span in self.spans}
        ids = tuple(span.id for span in self.spans)
        if len(sizes) != 1 or len(set(ids)) != len(ids):
            raise ValueError(f"instruction {packet.instruction} of {len(ids)} devices: no one answer fits it")
        size = sizes.pop()
        self.reply: PendingReply = FastSyncReadReply(ids, size) if self.fast else StatusReply(ids, size)

    def parse_replies(self, chunks: Sequence[bytes]) -> tuple[tuple[DeviceReply, ...], tuple[int, ...], int]:
        """Parse the answer bytes; return the replies, the ids without a reply, and the number of chunks used.

        That number is the count of chunks until the answer was complete; all of them also if it never was.
        """
        reply = self.reply
        done = len(chunks)
        reply.start()
        for place, chunk in enumerate(chunks):
            if self._take(chunk):
                done = place + 1
                break
        reply.end()
        told = tuple(
            each
            for row in range(len(self.spans))
            if reply.answered[row]
            for each in self._replies_of_row(row)
        )
        heard = {each.id for each in told}
        missed = tuple(span.id for span in self.spans if span.id not in heard)
        return told, missed[:1] if self.fast else missed, done

    def _replies_of_row(self, row: int) -> Iterator[DeviceReply]:
        span = self.spans[row]
        error = int(self.reply.error[row])
        data = self.reply.data[row].tobytes()
        if not self.reply.heard[row]:
            yield DeviceReply(span.id, error, -1, b"")
        elif self.ping:
            yield DeviceReply(span.id, error, 0, data[:2])
            yield DeviceReply(span.id, error, FIRMWARE, data[2:])
        else:
            yield DeviceReply(span.id, error, span.address, data)

    def _take(self, chunk: bytes) -> bool:
        while chunk:
            room = self.reply.receive_buffer()
            part = chunk[: len(room)]
            chunk = chunk[len(room) :]
            room[: len(part)] = part
            if self.reply.take(len(part)):
                return True
        return False


def exchanges(entries: Iterable[FlightEntry]) -> list[RecordedExchange]:
    """Group the OUT and IN entries of one bus, in time order, into exchanges.

    Entries before the first write are left out.
    """
    questions: dict[bytes, RequestParser | None] = {}
    found: list[RecordedExchange] = []
    out: FlightEntry | None = None
    chunks: list[tuple[float, bytes]] = []
    for entry in entries:
        if entry.kind == EntryKind.IN and out is not None:
            chunks.append((entry.time - out.time, entry.data))
        elif entry.kind == EntryKind.OUT:
            if out is not None:
                found.append(_exchange(out, chunks, questions, entry.time - out.time))
            out = entry
            chunks = []
    if out is not None:
        found.append(_exchange(out, chunks, questions, None))
    return found


def packets(data: bytes) -> Iterator[bytes]:
    """The packets of one write, whole as they are on the wire; what is none ends it."""
    at = 0
    while data.startswith(HEADER, at) and at + OVERHEAD <= len(data):
        size = (data[at + 5] | data[at + 6] << 8) + 7
        yield data[at : at + size]
        at += size


def asks(packet: bytes) -> bool:
    """Does this packet ask, and change nothing?"""
    return packet[7] in QUESTIONS


def _exchange(
    out: FlightEntry,
    chunks: list[tuple[float, bytes]],
    questions: dict[bytes, RequestParser | None],
    until: float | None,
) -> RecordedExchange:
    """`until`: s after it the next one left."""
    asking = b""
    writes = list[RegisterAccess]()
    for packet in packets(out.data):
        if asks(packet):
            asking = packet
        else:
            writes += _written(packet)
    bare = RecordedExchange(out.time, asking, tuple(writes), tuple(chunks), False, (), ())
    if not asking:
        return bare
    if asking not in questions:
        questions[asking] = _question(asking)
    question = questions[asking]
    if question is None:
        return bare
    told, missed, done = question.parse_replies([data for _, data in chunks])
    if until is None and missed:  # what would have come is unknown
        return replace(bare, asks=b"")
    answers = tuple(_earlier(chunks, done, until))
    return replace(bare, told=told, missed=missed, answers=answers, whole=not missed)


def _question(packet: bytes) -> RequestParser | None:
    for found in Framer(status=False).feed(packet):
        try:
            return RequestParser(found)
        except ValueError:
            return None
    return None


def _earlier(
    chunks: list[tuple[float, bytes]], done: int, until: float | None
) -> Iterator[tuple[float, bytes]]:
    """Correct the times of chunks that were found waiting when the next request left.

    Such a chunk arrived half-way between the read before it and its own read.
    """
    before = 0.0
    for place, (at, data) in enumerate(chunks):
        late = until is not None and until - at < THROWN and (place >= done or at - before > PAUSE)
        yield ((before + at) / 2.0 if late else at, data)
        before = at


def _register_accesses(packet: Packet) -> Iterator[RegisterAccess]:
    params = packet.params
    match packet.instruction:
        case Instruction.PING if packet.id != BROADCAST:
            yield RegisterAccess(packet.id, 0, bytes(PINGED))
        case Instruction.READ:
            yield RegisterAccess(packet.id, _word(params, 0), bytes(_word(params, 2)))
        case Instruction.SYNC_READ | Instruction.FAST_SYNC_READ:
            for id in params[4:]:
                yield RegisterAccess(id, _word(params, 0), bytes(_word(params, 2)))
        case Instruction.BULK_READ | Instruction.FAST_BULK_READ:
            for at in range(0, len(params) - 4, 5):
                yield RegisterAccess(params[at], _word(params, at + 1), bytes(_word(params, at + 3)))


def _written(packet: bytes) -> Iterator[RegisterAccess]:
    for found in Framer(status=False).feed(packet):
        params = found.params
        if found.instruction == Instruction.WRITE:
            yield RegisterAccess(found.id, _word(params, 0), params[2:])
        elif found.instruction == Instruction.SYNC_WRITE:
            size = _word(params, 2)
            for at in range(4, len(params) - size, size + 1):
                yield RegisterAccess(params[at], _word(params, 0), params[at + 1 : at + 1 + size])


def _word(params: bytes, at: int) -> int:
    return int.from_bytes(params[at : at + 2], "little")
