"""Bits on a line: one sender is heard as it speaks, two are heard as the line between them."""

from hypothesis import given
from hypothesis import strategies as st

from twind_drivers.virtual.uart_receiver import clash, misheard

MBAUD = 1_000_000
BYTE = 10 / MBAUD  # s


@given(st.binary(min_size=1, max_size=40), st.floats(0.0, 10.0))
def test_bytes_of_a_single_sender_are_received_unchanged(data: bytes, start: float) -> None:
    assert clash([(start, data)], MBAUD) == data


@given(st.binary(min_size=1, max_size=20), st.binary(min_size=1, max_size=20), st.floats(0.0, 1e-3))
def test_two_transmissions_without_overlap_are_both_received(first: bytes, second: bytes, gap: float) -> None:
    start = len(first) * BYTE + gap
    assert clash([(start, second), (0.0, first)], MBAUD) == first + second


@given(st.binary(min_size=1, max_size=20), st.binary(min_size=1, max_size=20))
def test_two_synchronous_senders_are_received_as_the_bitwise_and(first: bytes, second: bytes) -> None:
    """A UART line idles high and a sender pulls it low: where they meet, 0 wins."""
    both = bytes(a & b for a, b in zip(first, second, strict=False))
    longer = max(first, second, key=len)
    assert clash([(0.0, first), (0.0, second)], MBAUD) == both + longer[len(both) :]


def test_a_partial_overlap_is_valid_before_and_corrupt_after_its_start() -> None:
    heard = clash([(0.0, b"hello world"), (5.43 * BYTE, b"HELLO")], MBAUD)
    assert heard[:5] == b"hello"
    assert heard[5:] not in (b" world", b"HELLO", b" worldHELLO")


def test_a_rate_within_two_percent_is_understood_and_double_is_not() -> None:
    """8N1 is sampled at the middle of the bits: over ten of them 5 % are half a bit."""
    data = bytes(range(256))
    assert misheard(data, MBAUD, MBAUD) == data
    assert misheard(data, MBAUD, 1_020_000) == data
    assert misheard(data, MBAUD, 2 * MBAUD) != data
    assert misheard(data, 2 * MBAUD, MBAUD) != data
    assert len(misheard(data, 2 * MBAUD, MBAUD)) < len(data)
