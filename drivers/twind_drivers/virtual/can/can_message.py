"""Frame on the virtual wire: its arbitration rank and its length in bits. Pure."""

import re
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from twind_drivers.ports.frame import (
    BYTES,
    EXTENDED,
    EXTENDED_MASK,
    FRAME,
    REMOTE,
    STANDARD_MASK,
    Frames,
    payload,
)

CRC = 0x4599  # ISO 11898-1: x15 + x14 + x10 + x8 + x7 + x4 + x3 + 1
TAIL = 13  # bits that are never stuffed: CRC and ACK delimiters, ACK, 7 end of frame, 3 between frames
SHORTEST = 47  # bits of the shortest frame: no data, no stuffing
# Where a stuff bit goes: after five equal bits; it is the first of the next run, so four more make another.
RUNS = re.compile(r"0{5}(?:1{4}0{4})*(?:1{4})?|1{5}(?:0{4}1{4})*(?:0{4})?")


class CanMessage(NamedTuple):
    """CAN frame: `id` with the flags of `twind_drivers.ports.frame`; at most 8 bytes."""

    id: int
    data: bytes = b""


def messages(frames: Frames) -> list[CanMessage]:
    """Each frame of (k,), in order."""
    return [CanMessage(int(frame["id"]), payload(frame)) for frame in frames]


def as_frames(messages: Iterable[CanMessage]) -> Frames:
    """Return messages as frames (k,), in order."""
    listed = list(messages)
    made = np.zeros(len(listed), FRAME)
    for row, (id, data) in enumerate(listed):
        made[row]["id"] = id
        made[row]["size"] = len(data)
        made[row]["data"] = np.frombuffer(data.ljust(BYTES, b"\0"), np.uint8)
    return made


def rank(id: int) -> int:
    """Return the arbitration rank of an id, its bits as they stand on the wire.

    The lower rank wins when two frames begin at once.
    """
    remote = 1 if id & REMOTE else 0
    if id & EXTENDED:
        whole = id & EXTENDED_MASK
        return (whole >> 18) << 21 | 0b11 << 19 | (whole & 0x3FFFF) << 1 | remote
    return (id & STANDARD_MASK) << 21 | remote << 20


def bits(message: CanMessage) -> int:
    """Bits on the wire, stuff bits of exactly this frame and the pause behind it included.

    8 bytes: 111 to 135 with an 11-bit id, 131 to 160 with 29 bits.
    """
    id, data = message
    remote = 1 if id & REMOTE else 0
    size = 0 if remote else len(data)
    if id & EXTENDED:
        whole = id & EXTENDED_MASK
        head = ((whole >> 18) << 20 | 0b11 << 18 | whole & 0x3FFFF) << 3 | remote << 2
        width = 34
    else:
        head = (id & STANDARD_MASK) << 3 | remote << 2
        width = 14
    # DLC, and the start bit, which is 0
    head = head << 4 | len(data)
    width = width + 4 + 1
    body = head << 8 * size | int.from_bytes(data[:size], "big")
    width += 8 * size
    line = format(body << 15 | _crc(body, width), f"0{width + 15}b")
    runs = RUNS.findall(line)  # each of 4 k + 1 bits has k stuff bits
    return len(line) + (sum(map(len, runs)) - len(runs)) // 4 + TAIL


def _table() -> tuple[int, ...]:
    made = []
    for byte in range(256):
        crc = byte << 7
        for _ in range(8):
            crc = crc << 1 ^ (CRC if crc & 0x4000 else 0)
        made.append(crc & 0x7FFF)
    return tuple(made)


TABLE = _table()


def _crc(body: int, width: int) -> int:
    """Return the CRC-15 of `width` bits of `body`, the highest first; zeros before them change nothing."""
    crc = 0
    for byte in body.to_bytes((width + 7) // 8, "big"):
        crc = (crc << 8 & 0x7FFF) ^ TABLE[(crc >> 7) ^ byte]
    return crc
