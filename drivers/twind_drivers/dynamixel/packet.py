"""Dynamixel Protocol 2.0 packets, both directions: build, stuff, find in a stream. Pure: bytes in, bytes out.

`FF FF FD 00 | ID | LEN_L LEN_H | INST | params ... | CRC_L CRC_H`, little-endian; LEN = params + 3. Over INST
and the params an FD is inserted after every `FF FF FD`; LEN and CRC are of the stuffed bytes (e-manual,
"Protocol 2.0"). Fast replies are not stuffed; `Framer` skips them, since only the request gives their layout.
"""

from collections.abc import Mapping, Sequence
from enum import IntEnum
from typing import NamedTuple

from twind_drivers.dynamixel.crc import crc16

HEADER = b"\xff\xff\xfd\x00"
PATTERN = b"\xff\xff\xfd"
STUFFED = b"\xff\xff\xfd\xfd"
BROADCAST = 0xFE
LAST_ID = 252
STATUS = 0x55
ALERT = 0x80  # bit 7 of the error byte: hardware error, see register 70
OVERHEAD = 10  # bytes of an instruction packet without params: header 4, id, LEN 2, INST, CRC 2
STATUS_OVERHEAD = 11  # the same with the error byte
CAPACITY = 2048  # bytes a Framer holds at most; a LEN beyond it is not plausible

Bytes = bytes | bytearray | memoryview


class Instruction(IntEnum):
    """Instruction codes (e-manual, "Instruction Packet")."""

    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    REG_WRITE = 0x04
    ACTION = 0x05
    FACTORY_RESET = 0x06
    REBOOT = 0x08
    CLEAR = 0x10
    BACKUP = 0x20
    STATUS = 0x55
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83
    FAST_SYNC_READ = 0x8A
    BULK_READ = 0x92
    BULK_WRITE = 0x93
    FAST_BULK_READ = 0x9A


class StatusErrorCode(IntEnum):
    """Bits 0-6 of the error byte: a number, not flags (e-manual, "Error")."""

    NONE = 0
    RESULT_FAIL = 1
    INSTRUCTION = 2
    CRC = 3
    DATA_RANGE = 4
    DATA_LENGTH = 5
    DATA_LIMIT = 6
    ACCESS = 7


REASONS: Mapping[int, str] = {
    StatusErrorCode.RESULT_FAIL: "could not be carried out",
    StatusErrorCode.INSTRUCTION: "unknown instruction",
    StatusErrorCode.CRC: "our packet arrived with a wrong CRC",
    StatusErrorCode.DATA_RANGE: "value out of range, or goal locked because the bus watchdog has tripped",
    StatusErrorCode.DATA_LENGTH: "fewer bytes than the register has",
    StatusErrorCode.DATA_LIMIT: "value beyond the configured limit register",
    StatusErrorCode.ACCESS: "register is read-only, undefined, or EEPROM while torque is on",
}


def explain(error: int) -> str:
    """Return the meaning of an error byte, in words."""
    number = error & 0x7F
    words = REASONS.get(number, f"error number {number}") if number else "no error"
    return f"{words} (alert: hardware error, see register 70)" if error & ALERT else words


# --------------------------------------------------------------------------------------------- building


def stuff(body: Bytes) -> bytes:
    """Return INST and params as sent: with FD after every FF FF FD."""
    return bytes(body).replace(PATTERN, STUFFED)


def unstuff(body: Bytes) -> bytes:
    """Return the bytes without stuffing: the inverse of `stuff`."""
    return bytes(body).replace(STUFFED, PATTERN)


def instruction(id: int, code: int, params: Bytes = b"") -> bytes:
    """Build one packet, stuffed, with LEN and CRC. Raises ValueError for an id not 0..252 or 254."""
    if not (0 <= id <= LAST_ID or id == BROADCAST):
        raise ValueError(f"id {id} is not one of 0..{LAST_ID} or {BROADCAST} (broadcast)")
    body = stuff(bytes((code,)) + params)
    packet = HEADER + bytes((id,)) + (len(body) + 2).to_bytes(2, "little") + body
    return packet + crc16(packet).to_bytes(2, "little")


def status(id: int, error: int, data: Bytes = b"") -> bytes:
    """Build a status packet: the answer of a device."""
    return instruction(id, STATUS, bytes((error,)) + data)


def ping(id: int) -> bytes:
    """Build a ping of device `id` (or of all, by broadcast). The answer carries model number and firmware."""
    return instruction(id, Instruction.PING)


def read(id: int, address: int, size: int) -> bytes:
    """Build a read of `size` bytes from `address` of one device."""
    return instruction(id, Instruction.READ, _span(address, size))


def write(id: int, address: int, data: Bytes) -> bytes:
    """Build a write of `data` to `address` of one device."""
    return instruction(id, Instruction.WRITE, address.to_bytes(2, "little") + data)


def sync_read(ids: Sequence[int], address: int, size: int) -> bytes:
    """Build a read of the same block of several devices; each sends its own status, in this order."""
    return instruction(BROADCAST, Instruction.SYNC_READ, _span(address, size) + bytes(ids))


def fast_sync_read(ids: Sequence[int], address: int, size: int) -> bytes:
    """Build a fast sync read: as `sync_read`, with one common status."""
    return instruction(BROADCAST, Instruction.FAST_SYNC_READ, _span(address, size) + bytes(ids))


def sync_write(address: int, rows: Mapping[int, Bytes]) -> bytes:
    """Build a write of one size to the same address of several devices. No reply follows."""
    sizes = {len(data) for data in rows.values()}
    if len(sizes) != 1:
        raise ValueError(f"a sync write needs data of one size, got sizes {sorted(sizes)}")
    body = b"".join(bytes((id,)) + data for id, data in rows.items())
    return instruction(BROADCAST, Instruction.SYNC_WRITE, _span(address, sizes.pop()) + body)


def bulk_read(spans: Mapping[int, tuple[int, int]]) -> bytes:
    """Build a read of a separate block (address, size) per device; each sends a status, in this order."""
    return instruction(BROADCAST, Instruction.BULK_READ, _spans(spans))


def fast_bulk_read(spans: Mapping[int, tuple[int, int]]) -> bytes:
    """Build a fast bulk read: as `bulk_read`, with one common status."""
    return instruction(BROADCAST, Instruction.FAST_BULK_READ, _spans(spans))


def reboot(id: int) -> bytes:
    """Build a restart of one device."""
    return instruction(id, Instruction.REBOOT)


def fast_status(rows: Sequence[tuple[int, int, Bytes]], promised: int) -> list[bytes]:
    """Build the parts of a fast reply, one per device, from rows of (error, id, data).

    `promised` is the LEN of the whole reply as the first device announces it: sum(len(data) + 4) + 1 over all
    devices in the request, also silent ones. Not stuffed; every CRC covers all bytes before it.
    """
    chunks: list[bytes] = []
    sent = b""
    lead = HEADER + bytes((BROADCAST,)) + promised.to_bytes(2, "little") + bytes((STATUS,))
    for error, id, data in rows:
        chunk = lead + bytes((error, id)) + data
        sent += chunk
        check = crc16(sent).to_bytes(2, "little")
        sent += check
        chunks.append(chunk + check)
        lead = b""
    return chunks


def _span(address: int, size: int) -> bytes:
    return address.to_bytes(2, "little") + size.to_bytes(2, "little")


def _spans(spans: Mapping[int, tuple[int, int]]) -> bytes:
    return b"".join(bytes((id,)) + _span(*span) for id, span in spans.items())


# --------------------------------------------------------------------------------------------- finding


class Packet(NamedTuple):
    """Packet found in a stream, params unstuffed."""

    id: int
    instruction: int
    params: bytes
    intact: bool = True  # False: the CRC is wrong (only from a Framer that reports broken packets)

    @property
    def is_status(self) -> bool:
        """True for a status."""
        return self.instruction == STATUS

    @property
    def error(self) -> int:
        """Error byte of a status; 0 where there is none."""
        return self.params[0] if self.params else 0

    @property
    def data(self) -> bytes:
        """Bytes of a status behind its error byte."""
        return self.params[1:]

    @property
    def octets(self) -> int:
        """Bytes of the packet on the wire, stuffing included."""
        return len(stuff(bytes((self.instruction,)) + self.params)) + OVERHEAD - 1


class Framer:
    """Search for packets in a stream of untrusted bytes. Never raises, holds at most `CAPACITY` bytes.

    `status` chooses the direction: True finds statuses only, False everything else, None both. It finds no
    fast reply, whose layout only the request gives. Every header in the buffer is tried, so a false one in
    garbage delays no true one. `broken` also reports whole packets with a wrong CRC.
    """

    def __init__(self, *, status: bool | None, broken: bool = False) -> None:
        self.discarded = 0  # bytes dropped so far because they belonged to no packet of this direction
        self._status = status
        self._broken = broken
        self.buffer = bytearray()

    def __len__(self) -> int:
        """Bytes held because they may begin a packet."""
        return len(self.buffer)

    def clear(self) -> None:
        """Forget what is held; it counts as discarded."""
        self.discarded += len(self.buffer)
        self.buffer.clear()

    def feed(self, data: Bytes) -> list[Packet]:
        """Return the packets that `data` completes, in order."""
        found: list[Packet] = []
        view = memoryview(data)
        while len(view):
            room = CAPACITY - len(self.buffer)
            self.buffer += view[:room]
            view = view[room:]
            self._take(found)
        return found

    def _take(self, found: list[Packet]) -> None:
        buffer = self.buffer
        start = taken = used = 0
        pending = -1  # the first header whose packet is not whole yet
        while (start := buffer.find(HEADER, start)) >= 0:
            size = self._size(start)
            packet = None
            if start + size > len(buffer):
                pending = start if pending < 0 else pending
            elif size:
                packet = self._open(start, size)
            if packet is None or not packet.intact:
                found += [packet] if packet else []
                start += len(HEADER)
                continue
            found.append(packet)
            start += size
            taken = start
            used = used + size
            pending = -1
        keep = pending if pending >= 0 else max(taken, len(buffer) - _tail(buffer))
        self.discarded += keep - used
        del buffer[:keep]

    def _size(self, start: int) -> int:
        """Whole length of the packet at `start`, as far as it can be known; 0: not a packet for us."""
        buffer = self.buffer
        if start + 8 > len(buffer):
            return 8
        length = buffer[start + 5] | buffer[start + 6] << 8
        id = buffer[start + 4]
        code = buffer[start + 7]
        answer = code == STATUS
        legal = id <= LAST_ID or (id == BROADCAST and not answer)
        wanted = self._status is None or answer == self._status
        if not legal or not wanted or not (4 if answer else 3) <= length <= CAPACITY - 7:
            return 0
        return length + 7

    def _open(self, start: int, size: int) -> Packet | None:
        end = start + size
        with memoryview(self.buffer) as view:
            intact = crc16(view[start : end - 2]) == view[end - 2] | view[end - 1] << 8
        if not intact and not self._broken:
            return None
        body = unstuff(self.buffer[start + 7 : end - 2])
        return Packet(self.buffer[start + 4], body[0], body[1:], intact)


def find_packets(data: Bytes, *, status: bool | None) -> list[Packet]:
    """Return the whole sound packets in `data`; `status` as in `Framer`."""
    return Framer(status=status).feed(data)


def _tail(buffer: bytearray) -> int:
    """Return the number of last bytes that may be the beginning of a header."""
    return next((k for k in (3, 2, 1) if buffer.endswith(HEADER[:k])), 0)
