"""Packets are found in a stream of bytes, whatever stands between and in them, in pieces of any size."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import examples
from twind_drivers.dynamixel import packet as p
from twind_drivers.dynamixel.crc import crc16
from twind_drivers.dynamixel.packet import Framer, Packet

# ------------------------------------------------------------------------------------------- finding

PACKETS = st.builds(p.status, st.integers(0, 252), st.integers(0, 255), st.binary(max_size=40))


@given(st.lists(st.one_of(st.binary(max_size=30), PACKETS), max_size=12), st.integers(1, 50))
@examples(200)
def test_no_bytes_raise_or_grow_the_buffer_and_every_byte_is_accounted_for(
    parts: list[bytes], chunk: int
) -> None:
    stream = b"".join(parts)
    framer = Framer(status=True)
    used = 0
    for at in range(0, len(stream), chunk):
        for found in framer.feed(stream[at : at + chunk]):
            used += len(p.status(found.id, found.error, found.data))
        assert len(framer) <= p.CAPACITY
    assert used + framer.discarded + len(framer) == len(stream)


@given(st.binary(max_size=3000), PACKETS)
@examples(100)
def test_a_packet_is_found_behind_any_noise(garbage: bytes, good: bytes) -> None:
    framer = Framer(status=True)
    found = framer.feed(garbage) + framer.feed(good)
    assert found[-1].id == good[4]
    assert len(framer) == 0


def test_endless_false_headers_stay_bounded() -> None:
    framer = Framer(status=True)
    for _ in range(20):
        assert framer.feed(b"\xff\xff\xfd\x00\x01\xf9\x07\x55" * 100) == []
        assert len(framer) <= p.CAPACITY


def test_a_wrong_crc_is_dropped_and_reported_only_on_request() -> None:
    bad = bytearray(p.write(3, 116, b"\1\2\3\4"))
    bad[12] ^= 1
    assert Framer(status=False).feed(bad + p.ping(1)) == [Packet(1, 1, b"")]
    found = Framer(status=False, broken=True).feed(bad + p.ping(1))
    assert [(each.id, each.intact) for each in found] == [(3, False), (1, True)]


@pytest.mark.parametrize(
    "data",
    [
        p.ping(1),  # an instruction where a status is due: our own echo
        b"\xff\xff\xfd\x00\xfd\x04\x00\x55\x00\x00\x00",
        b"\xff\xff\xfd\x01" + p.status(1, 0)[4:],
        b"\xff\xff\xfd\xfd" + p.status(1, 0)[4:],
    ],
)
def test_a_packet_that_is_no_status_is_not_returned_as_one(data: bytes) -> None:
    assert Framer(status=True).feed(data + bytes(20)) == []


# ------------------------------------------------------------------------------------- bytes in pieces


def raw(id: int, length: int, body: bytes) -> bytes:
    """A packet as given, with a right CRC whatever else is wrong."""
    packet = p.HEADER + bytes((id,)) + length.to_bytes(2, "little") + body
    return packet + crc16(packet).to_bytes(2, "little")


NOISE = st.lists(
    st.one_of(
        st.binary(max_size=12),
        PACKETS,
        st.sampled_from([p.ping(1), p.HEADER, b"\xff\xff\xfd", b"\xff", b"\xff\xff\xfd\x00\x01\x30\x00\x55"]),
    ),
    max_size=8,
).map(b"".join)


@given(NOISE, st.sampled_from([True, False, None]), st.booleans())
@examples(150)
def test_byte_by_byte_the_same_packets_are_found_as_at_once(
    stream: bytes, status: bool | None, broken: bool
) -> None:
    whole = Framer(status=status, broken=broken)
    pieces = Framer(status=status, broken=broken)
    found = whole.feed(stream)
    slowly = [each for byte in stream for each in pieces.feed(bytes((byte,)))]
    kept = [each for each in found if each.intact]
    assert kept == [each for each in slowly if each.intact]
    assert len(pieces) + pieces.discarded == len(whole) + whole.discarded


@pytest.mark.parametrize(
    ("data", "held"),
    [
        (b"\x01\x02", 0),
        (b"\x01\xff", 1),
        (b"\xff\xff", 2),
        (b"\x07\xff\xff\xfd", 3),
        (b"\xff\xff\x01", 0),
        (p.HEADER, 4),
        (p.status(1, 0)[:7], 7),
        (p.status(1, 0)[:8], 8),
        (p.status(1, 0)[:10], 10),
        (p.status(1, 0), 0),
        (p.status(1, 0) + b"\xff", 1),
        (p.HEADER + b"\xfd\x04\x00\x55", 0),  # nobody has this id
        (p.HEADER + b"\x01\xfa\x07\x55", 0),  # longer than anything
        (p.HEADER + b"\x01\x04\x00\x02", 0),  # no status
    ],
)
def test_only_what_may_begin_a_packet_is_held(data: bytes, held: int) -> None:
    framer = Framer(status=True)
    framer.feed(data)
    assert len(framer) == held
    framer.clear()
    assert len(framer) == 0
    assert framer.discarded == len(data) - (11 if data.startswith(p.status(1, 0)) else 0)
    assert framer.feed(p.status(9, 0)) == [Packet(9, 0x55, b"\0")]  # nothing of it is left


@pytest.mark.parametrize("size", [255 - 4, 256 - 4, 300, 0x0700, p.CAPACITY - 11])
def test_a_packet_as_long_as_the_buffer_is_found(size: int) -> None:
    data = bytes(size)
    assert Framer(status=True).feed(p.status(5, 0, data)) == [Packet(5, 0x55, b"\0" + data)]


def test_a_packet_longer_than_the_buffer_is_discarded_at_once() -> None:
    framer = Framer(status=True)
    assert framer.feed(p.status(5, 0, bytes(p.CAPACITY - 10))[:8]) == []
    assert (len(framer), framer.discarded) == (0, 8)


@pytest.mark.parametrize(
    ("id", "as_status", "as_instruction"),
    [(0, True, True), (252, True, True), (253, False, False), (254, False, True), (255, False, False)],
)
def test_reserved_ids_are_accepted_only_in_their_packet_type(
    id: int, as_status: bool, as_instruction: bool
) -> None:
    answer = raw(id, 4, b"\x55\x00")
    question = raw(id, 3, b"\x01")
    for asked in (True, None):
        assert bool(Framer(status=asked).feed(answer)) is as_status
    for asked in (False, None):
        assert bool(Framer(status=asked).feed(question)) is as_instruction
    assert Framer(status=False).feed(answer) == Framer(status=True).feed(question) == []


@pytest.mark.parametrize(
    ("length", "body", "found"),
    [
        (2, b"", 0),
        (3, b"\x01", 1),
        (3, b"\x55", 0),  # a status without an error byte is none
        (4, b"\x55\x00", 1),
    ],
)
def test_the_shortest_packets(length: int, body: bytes, found: int) -> None:
    assert len(Framer(status=None).feed(raw(1, length, body) + bytes(8))) == found


def test_a_good_packet_inside_a_broken_one_is_found_too() -> None:
    inner = p.ping(7)
    outer = bytearray(p.write(3, 116, bytes(30)))
    outer[20 : 20 + len(inner)] = inner
    found = Framer(status=False, broken=True).feed(bytes(outer))
    assert [(each.id, each.intact) for each in found] == [(3, False), (7, True)]
    assert Framer(status=False).feed(bytes(outer)) == [Packet(7, 1, b"")]


def test_a_broken_packet_is_reported_though_a_false_header_stands_in_it() -> None:
    outer = bytearray(p.write(3, 116, bytes(30)))
    outer[20:24] = p.HEADER
    framer = Framer(status=False, broken=True)
    found = framer.feed(outer[:26]) + framer.feed(outer[26:])
    assert [(each.id, each.intact) for each in found] == [(3, False)]


class Watched(bytearray):
    """A buffer that remembers how long it ever was."""

    longest = 0

    def __iadd__(self, more: bytes) -> "Watched":
        super().__iadd__(more)
        self.longest = max(self.longest, len(self))
        return self


def test_not_even_a_flood_makes_the_buffer_longer_than_its_capacity() -> None:
    framer = Framer(status=True)
    framer.buffer = buffer = Watched()
    framer.feed(b"\xff\xff\xfd\x00\x01\xf9\x07\x55" * 1_000)
    framer.feed(p.HEADER[:3] * 2_000)
    assert 8 < buffer.longest <= p.CAPACITY == 2048
