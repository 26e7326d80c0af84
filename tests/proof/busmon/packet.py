"""Packets as bytes: framing without mercy, stuffing, and how to make one."""

from tests.proof.busmon.crc import bitwise, crc16

HEADER = b"\xff\xff\xfd\x00"
PATTERN = b"\xff\xff\xfd"
BROADCAST = 254
LONGEST = 4096  # LEN; a sync write to 252 servos has 1281 before stuffing
STATUS = 0x55


class Malformed(Exception):
    """Bytes that are no packet; `skip`: how many of them to pass over."""

    def __init__(self, text: str, skip: int) -> None:
        super().__init__(text)
        self.skip = skip


def size_of(data: bytes, at: int) -> int:
    """Size of the packet that begins at `at`; 0: not all of it is there. Raises Malformed."""
    head = data[at : at + 4]
    if head != HEADER[: len(head)]:
        then = data.find(PATTERN, at + 1)
        raise Malformed(f"no header: {data[at : at + 16].hex(' ')}", (then if then > 0 else len(data)) - at)
    if len(data) - at >= 5 and data[at + 4] in (253, 255):
        raise Malformed(f"id {data[at + 4]} is none", 4)
    if len(data) - at < 7:
        return 0
    length = data[at + 5] | data[at + 6] << 8
    if not 3 <= length <= LONGEST:
        raise Malformed(f"LEN {length} is impossible", 4)
    return length + 7 if len(data) - at >= length + 7 else 0


def open_packet(packet: bytes) -> tuple[int, int, bytes]:
    """(id, instruction, params without stuffing) of a whole packet. Raises Malformed."""
    if crc16(packet[:-2]) != packet[-2] | packet[-1] << 8:
        raise Malformed("the CRC does not match", len(packet))
    body = packet[7:-2]
    if PATTERN in body:
        body = unstuff(body)
    return packet[4], body[0], body[1:]


def unstuff(body: bytes) -> bytes:
    """INST and params as meant. Raises Malformed where FF FF FD is not followed by the FD it needs."""
    parts = []
    at = 0
    while (found := body.find(PATTERN, at)) >= 0:
        if body[found + 3 : found + 4] != b"\xfd":
            raise Malformed("FF FF FD inside a packet without its stuffing byte", len(body) + 9)
        parts.append(body[at : found + 3])
        at = found + 4
    return b"".join((*parts, body[at:]))


def stuff(body: bytes) -> bytes:
    """INST and params as they go on the wire."""
    out = bytearray()
    for byte in body:
        out.append(byte)
        if out[-3:] == PATTERN:
            out.append(0xFD)
    return bytes(out)


def make(id: int, instruction: int, params: bytes = b"") -> bytes:
    """A packet of these."""
    body = stuff(bytes((instruction,)) + params)
    head = HEADER + bytes((id,)) + (len(body) + 2).to_bytes(2, "little") + body
    return head + bitwise(head).to_bytes(2, "little")
