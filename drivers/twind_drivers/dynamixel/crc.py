"""CRC-16/UMTS (poly 8005, init 0, not reflected) of Dynamixel Protocol 2.0. Pure.

One packet: the compiled `fastcrc`, 0.13 µs where numpy takes 1.8 (342 bytes, 2026-11). All rows of a reply at
once: position tables. For init 0 the CRC is linear: the xor of the contributions of the bytes, each by its
distance from the end. So all rows take one table access and one xor-reduction.
"""

from functools import cache

import numpy as np
from fastcrc import crc16 as _compiled
from numpy.typing import NDArray

POLYNOMIAL = 0x8005
umts = _compiled.umts  # CRC of bytes; 0 for none


@cache
def byte_table() -> NDArray[np.uint16]:
    """Table (256,) of the CRCs of one byte. `byte_table()[1]` is 8005, `[255]` is 0202."""
    table = np.arange(256, dtype=np.uint32) << 8
    for _ in range(8):
        table = (table << 1) ^ np.where(table & 0x8000, POLYNOMIAL, 0).astype(np.uint32)
    return (table & 0xFFFF).astype(np.uint16)


@cache
def _positions(rows: int) -> NDArray[np.uint16]:
    """Table (rows, 256): at [p, b] the CRC of byte b followed by rows-1-p zero bytes."""
    one = byte_table()
    table = np.zeros((rows, 256), np.uint16)
    table[rows - 1] = one
    for p in range(rows - 2, -1, -1):  # one more zero byte fed
        t = table[p + 1].astype(np.uint32)
        table[p] = ((t << 8) & 0xFFFF) ^ one[t >> 8]
    table.setflags(write=False)
    return table


class Crc:
    """CRC of rows of a fixed `length` (bytes): one call for a whole reply."""

    def __init__(self, length: int) -> None:
        rows = 1 << max(5, (length - 1).bit_length())  # few tables, each a power of two
        self.length = length
        self._table = _positions(rows)[rows - length :].reshape(-1)
        self._offsets = np.arange(length, dtype=np.intp) * 256

    def __call__(self, rows: NDArray[np.uint8]) -> NDArray[np.uint16]:
        """Return the CRCs (...) of rows (..., length)."""
        crc: NDArray[np.uint16] = np.bitwise_xor.reduce(self._table.take(rows + self._offsets), axis=-1)
        return crc


def crc16(data: bytes | bytearray | memoryview) -> int:
    """Return the CRC of `data`, 0 for no bytes."""
    return int(umts(data))
