"""CRC by position tables: the published check values, and equality with the bit-by-bit definition."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import examples
from twind_drivers.dynamixel.crc import Crc, _positions, byte_table, crc16


def bitwise(data: bytes) -> int:
    """The definition: poly 8005, init 0, most significant bit first."""
    register = 0
    for byte in data:
        register ^= byte << 8
        for _ in range(8):
            register = ((register << 1) ^ 0x8005 if register & 0x8000 else register << 1) & 0xFFFF
    return register


def test_the_published_check_values_hold() -> None:
    assert crc16(b"123456789") == 0xFEE8
    assert byte_table()[1] == 0x8005
    assert byte_table()[255] == 0x0202
    assert crc16(b"") == 0


@given(st.binary(max_size=400))
@examples(150)
def test_the_table_crc_equals_the_bitwise_definition(data: bytes) -> None:
    assert crc16(data) == bitwise(data)


@pytest.mark.parametrize("length", [1, 3, 19, 32, 33, 342])
def test_all_rows_at_once_equal_each_row_alone(length: int) -> None:
    rows = np.random.default_rng(length).integers(0, 256, (5, length), np.uint8)
    assert Crc(length)(rows).tolist() == [bitwise(row.tobytes()) for row in rows]


def test_every_single_bit_flip_is_seen() -> None:
    data = bytearray(range(40))
    right = crc16(data)
    for bit in range(8 * len(data)):
        data[bit // 8] ^= 1 << bit % 8
        assert crc16(data) != right
        data[bit // 8] ^= 1 << bit % 8


def test_rows_may_stand_in_any_number_of_dimensions() -> None:
    rows = np.random.default_rng(1).integers(0, 256, (2, 3, 19), np.uint8)
    crc = Crc(19)
    assert crc.length == 19
    assert crc(rows).shape == (2, 3)
    assert int(crc(rows[1, 2])) == int(crc(rows)[1, 2]) == bitwise(rows[1, 2].tobytes())


def test_the_table_that_all_share_cannot_be_written_to() -> None:
    assert not _positions(32).flags.writeable
