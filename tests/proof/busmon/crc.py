"""CRC-16 of protocol 2.0: polynomial 8005, begins at 0, not reflected, no final xor. Bit by bit is the truth;
the tables that make it fast are made of it."""

import numpy as np

POLYNOMIAL = 0x8005
LONGEST = 1024  # bytes that the tables serve


def bitwise(data: bytes, crc: int = 0) -> int:
    """The CRC as the protocol's text defines it."""
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1) ^ POLYNOMIAL if crc & 0x8000 else crc << 1
            crc &= 0xFFFF
    return crc


def _tables() -> np.ndarray:
    """Contribution of each byte, by its place from the end, to the CRC of a message: it is linear, and
    zeros before a message add nothing."""
    single = np.array([bitwise(bytes((byte,))) for byte in range(256)], np.uint16)
    table = np.zeros((LONGEST, 256), np.uint16)
    table[-1] = single
    for place in range(LONGEST - 2, -1, -1):
        later = table[place + 1].astype(np.uint32)
        table[place] = ((later << 8) & 0xFFFF) ^ single[later >> 8]
    return table


TABLES = _tables()
PLACES = np.arange(LONGEST)


def crc16(data: bytes) -> int:
    """The same number, by tables."""
    first = LONGEST - len(data)
    if first == LONGEST or first < 0:
        return bitwise(data)
    return int(np.bitwise_xor.reduce(TABLES[PLACES[first:], np.frombuffer(data, np.uint8)]))
