"""Feetech packets, both directions: build, and find in a stream. Pure: bytes in, bytes out.

`FF FF | ID | LEN | INST or ERR | params or data | CHK`; LEN = params + 2, CHK = NOT(sum from ID on). Nothing
is stuffed. A request and a status have the same form, and the checksum is weak: 2 bad bytes pass in 0.4 %.
"""

from collections.abc import Mapping, Sequence
from enum import IntEnum
from typing import NamedTuple

HEADER = b"\xff\xff"
BROADCAST = 0xFE
LAST_ID = 0xFD
OVERHEAD = 6  # bytes of a packet without params

Bytes = bytes | bytearray | memoryview


class FeetechInstruction(IntEnum):
    """Instruction codes. `REBOOT` enters the boot loader for 0.8 s and has no reply."""

    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    REG_WRITE = 0x04
    ACTION = 0x05
    RECOVERY = 0x06
    REBOOT = 0x08
    CLEAR_TURNS = 0x0A
    CALIBRATE = 0x0B
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83


# Bits of the error byte: the state of the servo now, not the result of an instruction.
FAULTS: Mapping[int, str] = {
    0x01: "supply voltage",
    0x02: "encoder",
    0x04: "temperature",
    0x08: "current",
    0x20: "overload",
}
FAULT_BITS = sum(FAULTS)


def explain(error: int) -> str:
    """Return the meaning of an error byte, in words."""
    return ", ".join(text for bit, text in FAULTS.items() if error & bit) or "no error"


def instruction(id: int, code: int, params: Bytes = b"") -> bytes:
    """Build an instruction packet; a status has the same form, with its error byte as `code`."""
    body = bytes((id, len(params) + 2, code)) + params
    return HEADER + body + bytes((~sum(body) & 0xFF,))


def read(id: int, address: int, size: int) -> bytes:
    """Build a read of one device."""
    return instruction(id, FeetechInstruction.READ, bytes((address, size)))


def write(id: int, address: int, data: Bytes) -> bytes:
    """Build a write to one device, or to all (`BROADCAST`), which has no reply."""
    return instruction(id, FeetechInstruction.WRITE, bytes((address,)) + data)


def sync_read(ids: Sequence[int], address: int, size: int) -> bytes:
    """Build a read of the same block of several devices; each sends a status, in this order."""
    return instruction(BROADCAST, FeetechInstruction.SYNC_READ, bytes((address, size, *ids)))


def sync_write(address: int, data: Mapping[int, bytes]) -> bytes:
    """Build a write of equally long data to several devices. Raises ValueError for different lengths."""
    sizes = {len(each) for each in data.values()}
    if len(sizes) != 1:
        raise ValueError(f"a sync write needs data of one length, got {sorted(sizes)}")
    rows = b"".join(bytes((id,)) + each for id, each in data.items())
    return instruction(BROADCAST, FeetechInstruction.SYNC_WRITE, bytes((address, *sizes)) + rows)


def to_word(value: int, sign: int | None) -> int:
    """Encode a number: sign and magnitude with bit `sign`; None: without sign. Raises OverflowError."""
    most = 0xFFFF if sign is None else (1 << sign) - 1
    if not (-most if sign is not None else 0) <= value <= most:
        raise OverflowError(f"{value} does not fit a word with sign bit {sign}")
    return value if value >= 0 else -value | 1 << (sign or 0)


def from_word(word: int, sign: int | None) -> int:
    """Decode sign and magnitude; minus zero is 0."""
    if sign is None or not word >> sign & 1:
        return word
    return -(word & (1 << sign) - 1)


class FeetechPacket(NamedTuple):
    """Whole packet with a right checksum, of either direction."""

    id: int
    code: int  # instruction, or error byte
    data: bytes

    @property
    def is_status(self) -> bool:
        """Return True: it may be one, only the request decides."""
        return True

    @property
    def octets(self) -> int:
        """Bytes of the packet on the wire."""
        return len(self.data) + OVERHEAD


def is_sound(data: Bytes, start: int, end: int) -> bool:
    """Check the checksum of the packet from `start` to `end`."""
    return sum(data[start + 2 : end]) & 0xFF == 0xFF


def find_packets(data: Bytes, *, status: bool | None = None) -> list[FeetechPacket]:
    """Return the whole sound packets in `data`, in order; `status` True: without those to all devices.

    Every header is tried, so a false one in garbage hides no true one.
    """
    found: list[FeetechPacket] = []
    raw = bytes(data)
    start = raw.find(HEADER)
    while 0 <= start <= len(raw) - OVERHEAD:
        id = raw[start + 2]
        end = start + raw[start + 3] + 4
        legal = id <= (LAST_ID if status else BROADCAST) and raw[start + 3] >= 2
        if legal and end <= len(raw) and is_sound(raw, start, end):
            found.append(FeetechPacket(id, raw[start + 4], raw[start + 5 : end - 1]))
            start = raw.find(HEADER, end)
        else:
            start = raw.find(HEADER, start + 1)
    return found
