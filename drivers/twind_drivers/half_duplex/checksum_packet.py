"""Packets of the framing `FF FF`, both directions: build, and find in a stream. Pure: bytes in, bytes out.

Feetech and Dynamixel Protocol 1.0 have it: `FF FF | ID | LEN | INST or ERR | params or data | CHK`, with
LEN = params + 2, CHK = NOT(sum from ID on). Nothing is stuffed. A request and a status have the same form,
and the checksum is weak: 2 bad bytes pass in 0.4 %.
"""

from collections.abc import Mapping
from typing import NamedTuple

HEADER = b"\xff\xff"
BROADCAST = 0xFE
LAST_ID = 0xFD
OVERHEAD = 6  # bytes of a packet without params
# Instructions that every family with this framing has.
PING = 0x01
READ = 0x02
WRITE = 0x03
REG_WRITE = 0x04
ACTION = 0x05
SYNC_WRITE = 0x83

Bytes = bytes | bytearray | memoryview


def instruction(id: int, code: int, params: Bytes = b"") -> bytes:
    """Build an instruction packet; a status has the same form, with its error byte as `code`."""
    body = bytes((id, len(params) + 2, code)) + params
    return HEADER + body + bytes((~sum(body) & 0xFF,))


def read(id: int, address: int, size: int) -> bytes:
    """Build a read of one device."""
    return instruction(id, READ, bytes((address, size)))


def write(id: int, address: int, data: Bytes) -> bytes:
    """Build a write to one device, or to all (`BROADCAST`), which has no reply."""
    return instruction(id, WRITE, bytes((address,)) + data)


def sync_write(address: int, data: Mapping[int, bytes]) -> bytes:
    """Build a write of equally long data to several devices. Raises ValueError for different lengths."""
    sizes = {len(each) for each in data.values()}
    if len(sizes) != 1:
        raise ValueError(f"a sync write needs data of one length, got {sorted(sizes)}")
    rows = b"".join(bytes((id,)) + each for id, each in data.items())
    return instruction(BROADCAST, SYNC_WRITE, bytes((address, *sizes)) + rows)


class ChecksumPacket(NamedTuple):
    """Whole packet with a right checksum, of either direction."""

    id: int
    code: int  # instruction, or error byte
    data: bytes

    @property
    def is_status(self) -> bool:
        """Return True: it may be one, only the request decides."""
        return True

    @property
    def error(self) -> int:
        """Error byte, if it is a status."""
        return self.code

    @property
    def octets(self) -> int:
        """Bytes of the packet on the wire."""
        return len(self.data) + OVERHEAD


def is_sound(data: Bytes, start: int, end: int) -> bool:
    """Check the checksum of the packet from `start` to `end`."""
    return sum(data[start + 2 : end]) & 0xFF == 0xFF


def find_packets(data: Bytes, *, status: bool | None = None) -> list[ChecksumPacket]:
    """Return the whole sound packets in `data`, in order; `status` True: without those to all devices.

    Every header is tried, so a false one in garbage hides no true one.
    """
    found: list[ChecksumPacket] = []
    raw = bytes(data)
    start = raw.find(HEADER)
    while 0 <= start <= len(raw) - OVERHEAD:
        id = raw[start + 2]
        end = start + raw[start + 3] + 4
        legal = id <= (LAST_ID if status else BROADCAST) and raw[start + 3] >= 2
        if legal and end <= len(raw) and is_sound(raw, start, end):
            found.append(ChecksumPacket(id, raw[start + 4], raw[start + 5 : end - 1]))
            start = raw.find(HEADER, end)
        else:
            start = raw.find(HEADER, start + 1)
    return found
