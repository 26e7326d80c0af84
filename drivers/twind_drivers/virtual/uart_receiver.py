"""Bytes that a receiver decodes from a line with two senders at once, or with another rate. Pure: bits.

The line is a row of levels, 1 at rest. A byte is a start bit 0, eight bits with the lowest first, a stop bit
1 (8N1). Where two senders meet the line is low as soon as one of them pulls it low.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

SAMPLES = 16  # of a bit, as in the usual receiver
BYTE = 10 * SAMPLES
Levels = NDArray[np.bool_]


def clash(sent: Sequence[tuple[float, bytes]], baud: int) -> bytes:
    """Return the bytes received from several senders at once, each (start in s, bytes), all at `baud`."""
    first = min(start for start, _ in sent)
    places = [round((start - first) * baud * SAMPLES) for start, _ in sent]
    line = np.ones(max(at + len(data) * BYTE for at, (_, data) in zip(places, sent, strict=True)), np.bool_)
    for at, (_, data) in zip(places, sent, strict=True):
        line[at : at + len(data) * BYTE] &= np.repeat(_bits(data), SAMPLES)
    return _decode(line)


def misheard(data: bytes, sender_baud: int, receiver_baud: int) -> bytes:
    """Return the bytes that a receiver at `receiver_baud` decodes from `data` sent at `sender_baud`."""
    bits = _bits(data)
    count = -(-len(bits) * receiver_baud * SAMPLES // sender_baud)
    return _decode(bits[np.arange(count) * sender_baud // (receiver_baud * SAMPLES)])


def _bits(data: bytes) -> Levels:
    bits = np.ones((len(data), 10), np.bool_)
    bits[:, 0] = False
    bits[:, 1:9] = np.unpackbits(np.frombuffer(data, np.uint8)[:, None], axis=1, bitorder="little")
    return bits.ravel()


def _decode(line: Levels) -> bytes:
    """Return the bytes of a line. One without a stop bit reads as 0, as on a Linux tty (termios, PARMRK)."""
    line = np.concatenate((line, np.ones(2 * BYTE, np.bool_)))
    low = np.flatnonzero(~line)
    high = np.flatnonzero(line)
    middles = np.arange(10) * SAMPLES + SAMPLES // 2
    out = bytearray()
    at = 0
    while (next_low := int(np.searchsorted(low, at))) < len(low):
        start = int(low[next_low])
        bits = line[start + middles]
        if bits[0]:  # too short for a start bit
            at = start + SAMPLES // 2
        elif bits[9]:
            out += np.packbits(bits[1:9], bitorder="little").tobytes()
            at = start + 9 * SAMPLES + SAMPLES // 2
        else:
            out.append(0)
            at = int(high[np.searchsorted(high, start + 9 * SAMPLES + SAMPLES // 2)])
    return bytes(out)
