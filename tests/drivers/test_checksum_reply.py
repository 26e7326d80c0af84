"""Replies of the framing `FF FF`: statuses found among other bytes, and what is left over."""

from collections.abc import Sequence
from itertools import permutations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind_drivers.half_duplex import checksum_packet as p
from twind_drivers.half_duplex.checksum_reply import CAPACITY, ChecksumReply

IDS = st.integers(0, p.LAST_ID)
DATA = st.binary(max_size=40)
READS = (p.read(1, 56, 2), p.read(2, 56, 2))
FIRST = p.instruction(1, 4, b"\x18\x05")
SECOND = p.instruction(2, 8, b"\x19\x06")
DAMAGED = SECOND[:-1] + bytes((SECOND[-1] ^ 1,))
STREAMS = {
    "whole": FIRST + SECOND,
    "another order": SECOND + FIRST,
    "one missing": FIRST,
    "one damaged": FIRST + DAMAGED,
    "one refusing": p.instruction(1, 8) + SECOND,
    "one not whole": FIRST + SECOND[:-1],
    "with strays": b"\0" + FIRST + p.instruction(9, 0) + SECOND,
    "long": bytes(CAPACITY),
    "silent": b"",
}


def put(made: ChecksumReply, data: bytes) -> bool:
    """These bytes come; True if the reply is complete."""
    made.receive_buffer()[: len(data)] = data
    return made.take(len(data))


def reply(
    ids: Sequence[int], size: int, data: bytes, requests: Sequence[bytes] = (), *, refusals: bool = False
) -> ChecksumReply:
    """The reply after these bytes."""
    made = ChecksumReply(ids, size, requests, refusals=refusals)
    put(made, data)
    made.end()
    return made


def contents(made: ChecksumReply) -> tuple[object, ...]:
    """All that a reply contains."""
    arrays = (made.heard, made.answered, made.error, made.data)
    return made.whole, made.strays, made.first, list(made.unasked), *(each.tolist() for each in arrays)


@given(
    st.lists(st.tuples(IDS, st.integers(0, 63), st.binary(min_size=6, max_size=6)), min_size=1, max_size=8)
)
def test_whole_replies_are_read_in_their_order(rows: list[tuple[int, int, bytes]]) -> None:
    rows = list({row[0]: row for row in rows}.values())
    made = reply([id for id, _, _ in rows], 6, b"".join(p.instruction(*row) for row in rows))
    assert made.whole
    assert made.strays == 0
    assert made.error.tolist() == [error for _, error, _ in rows]
    assert [each.tobytes() for each in made.data] == [data for _, _, data in rows]


@given(DATA, st.integers(0, 2), st.binary(min_size=6, max_size=6))
def test_noise_around_replies_is_counted_and_a_missing_one_reads_zero(
    noise: bytes, gone: int, data: bytes
) -> None:
    """Noise may forge no reply of these ids here: it has no header of theirs."""
    noise = noise.replace(b"\xff", b"\0")
    rows = [b"" if place == gone else p.instruction(place + 1, 0, data) for place in range(3)]
    made = reply((1, 2, 3), 6, noise + noise.join(rows) + noise)
    assert made.heard.tolist() == [place != gone for place in range(3)]
    assert not made.data[gone].any()
    assert made.strays == 4 * len(noise)


def test_an_echo_is_no_reply_even_where_it_has_the_form_of_one() -> None:
    request = p.read(1, 56, 2)
    waiting = ChecksumReply((1,), 2, (request,))
    assert not put(waiting, request)
    assert not reply((1,), 2, request, (request,)).heard.any()
    made = reply((1,), 2, request + p.instruction(1, 0, b"\x18\x05"), (request,))
    assert made.data[0].tolist() == [0x18, 0x05]
    assert made.unasked == [p.ChecksumPacket(1, 2, b"\x38\x02")]


def test_echoes_of_single_reads_are_no_replies_of_silent_devices() -> None:
    made = ChecksumReply((1, 2), 2, READS)
    for echo in READS:
        assert not put(made, echo)
    made.end()
    assert (made.heard.any(), made.strays) == (False, 16)
    assert list(made.unasked) == p.find_packets(b"".join(READS))


def test_bytes_beyond_the_buffer_are_dropped_and_counted() -> None:
    made = ChecksumReply((1,), 2)
    for _ in range(3):
        put(made, bytes(CAPACITY))
    assert put(made, p.instruction(1, 0, b"\x18\x05"))
    made.end()
    assert (made.data[0].tolist(), made.strays) == ([0x18, 0x05], 3 * CAPACITY)


def test_packets_that_are_dropped_with_a_full_buffer_count_as_its_other_bytes() -> None:
    made = ChecksumReply((1, 2), 2)
    put(made, (FIRST + p.instruction(9, 0)).ljust(CAPACITY, b"\0"))
    assert put(made, FIRST + SECOND)
    made.end()
    assert (made.whole, made.strays, list(made.unasked)) == (True, CAPACITY, [])


@given(st.integers(1, 20))
def test_whole_replies_have_no_strays_wherever_their_bytes_are_cut(size: int) -> None:
    ids = (1, 2, 3)
    made = ChecksumReply(ids, 2, [p.read(id, 56, 2) for id in ids])
    data = b"".join(p.instruction(id, 0, b"\x18\x05") for id in ids)
    for at in range(0, len(data), size):
        put(made, data[at : at + size])
    made.end()
    assert (made.whole, made.strays, list(made.unasked)) == (True, 0, [])


@given(st.binary(max_size=300))
def test_no_bytes_raise(data: bytes) -> None:
    reply((1, 2), 6, data, (p.read(1, 56, 6), p.read(2, 56, 6)))


@pytest.mark.parametrize("refusals", [False, True])
@pytest.mark.parametrize("requests", [(), READS])
def test_a_regular_reply_is_all_that_came(requests: Sequence[bytes], refusals: bool) -> None:
    made = reply((1, 2), 2, FIRST + SECOND, requests, refusals=refusals)
    everybody = [True, True]
    assert contents(made) == (True, 0, b"", [], everybody, everybody, [4, 8], [[0x18, 0x05], [0x19, 0x06]])


@pytest.mark.parametrize("order", list(permutations((1, 2, 3))))
def test_replies_in_any_order_belong_to_their_ids(order: tuple[int, ...]) -> None:
    made = ChecksumReply((1, 2, 3), 2)
    assert put(made, b"".join(p.instruction(id, id + 3, bytes((id, 9))) for id in order))
    made.end()
    assert (made.whole, made.strays, made.first, list(made.unasked)) == (True, 0, b"", [])
    assert made.error.tolist() == [4, 5, 6]
    assert made.data.tolist() == [[1, 9], [2, 9], [3, 9]]


@pytest.mark.parametrize("behind", [b"", b"\0"])
def test_a_damaged_status_is_left_out_and_the_others_are_read(behind: bytes) -> None:
    third = p.instruction(3, 16, b"\x20\x07")
    data = FIRST + DAMAGED + third + behind
    made = ChecksumReply((1, 2, 3), 2)
    assert not put(made, data)
    made.end()
    heard = [True, False, True]
    rows = [[0x18, 0x05], [0, 0], [0x20, 0x07]]
    assert contents(made) == (False, len(DAMAGED + behind), data, [], heard, heard, [4, 0, 16], rows)


@pytest.mark.parametrize("behind", [b"", b"\0"])
def test_bytes_with_the_sum_of_a_status_and_another_length_are_no_reply(behind: bytes) -> None:
    made = ChecksumReply((1,), 2)
    for length in set(range(256)) - {4}:
        body = bytes((1, length, 0, 0x18, 0x05))
        made.start()
        assert not put(made, p.HEADER + body + bytes((~sum(body) & 0xFF,)) + behind)
        made.end()
        assert not made.heard[0]


@pytest.mark.parametrize(
    ("data", "strays"),
    [
        (b"", 0),
        (FIRST, 0),
        (FIRST + SECOND + b"\0\0", 2),
        (b"\xff" + FIRST + SECOND, 1),
        (FIRST + DAMAGED, 8),
    ],
)
def test_the_bytes_of_an_irregular_reply_are_kept(data: bytes, strays: int) -> None:
    made = reply((1, 2), 2, data)
    assert (made.first, made.strays) == (data, strays)


def test_the_first_status_of_a_device_counts() -> None:
    again = p.instruction(1, 0, b"\x20\x07")
    made = reply((1, 2), 2, FIRST + again + SECOND)
    assert (made.whole, made.strays, list(made.unasked)) == (True, 8, p.find_packets(again))
    assert (made.error.tolist(), made.data[0].tolist()) == ([4, 8], [0x18, 0x05])


def test_packets_of_others_are_listed_wherever_they_come() -> None:
    others = [p.instruction(id, 0, b"\x20\x07") for id in (7, 8, 9)]
    made = reply((1, 2), 2, others[0] + FIRST + others[1] + SECOND + others[2])
    assert (made.whole, made.strays, list(made.unasked)) == (True, 24, p.find_packets(b"".join(others)))


def test_a_reply_to_single_reads_shows_who_has_answered_so_far() -> None:
    made = ChecksumReply((1, 2), 2, READS)
    assert made.answered.tolist() == [False, False]
    assert not put(made, FIRST)
    assert made.answered.tolist() == [True, False]
    assert put(made, SECOND)
    assert made.answered.tolist() == [True, True]


def test_a_packet_within_the_data_of_a_status_is_none() -> None:
    data = p.instruction(9, 0) + b"\0\0"
    rows = [p.instruction(id, 0, data) for id in (1, 2)]
    made = ChecksumReply((1, 2), 8, READS)
    for piece in (rows[0][:-1], rows[0][-1:] + rows[1]):
        put(made, piece)
    made.end()
    assert (made.whole, made.strays, list(made.unasked)) == (True, 0, [])


def test_bytes_beyond_the_buffer_are_strays_of_a_silent_device_too() -> None:
    made = ChecksumReply((1,), 2)
    put(made, bytes(CAPACITY))
    assert not put(made, b"\0\0\0")
    made.end()
    assert (made.whole, made.strays, made.first) == (False, CAPACITY + 3, b"\0\0\0")


# ---------------------------------------------------------------------------- one reply after another


@pytest.mark.parametrize("refusals", [False, True])
@pytest.mark.parametrize("requests", [(), READS])
@pytest.mark.parametrize("before", STREAMS)
def test_a_reply_contains_nothing_of_the_one_before(
    before: str, requests: Sequence[bytes], refusals: bool
) -> None:
    made = ChecksumReply((1, 2), 2, requests, refusals=refusals)
    for name, data in STREAMS.items():
        put(made, STREAMS[before])
        made.end()
        made.start()
        assert (made.whole, made.strays, made.first, list(made.unasked)) == (False, 0, b"", [])
        assert not (made.heard | made.answered).any()
        put(made, data)
        made.end()
        assert contents(made) == contents(reply((1, 2), 2, data, requests, refusals=refusals)), name
        made.start()


@pytest.mark.parametrize("requests", [(), READS])
@pytest.mark.parametrize(
    ("before", "data"),
    [
        (FIRST, FIRST[:-1]),
        (b"\0" + FIRST, b"\0" + FIRST[:-1]),
        (FIRST + b"\1", FIRST[:-1] + bytes((FIRST[-1] - 1,))),
    ],
)
def test_bytes_of_an_earlier_reply_complete_no_later_one(
    before: bytes, data: bytes, requests: Sequence[bytes]
) -> None:
    made = ChecksumReply((1,), 2, requests)
    put(made, before)
    made.end()
    made.start()
    assert not put(made, data)
    made.end()
    assert not made.heard[0]
    assert made.first == data


# ---------------------------------------------------------------------------- refusals


@pytest.mark.parametrize("size", [1, 2])
def test_a_status_with_an_error_alone_is_an_answer_where_refusals_are_asked_for(size: int) -> None:
    good = p.instruction(1, 0, bytes(size))
    refusal = p.instruction(2, 8)
    made = reply((1, 2), size, good + refusal, refusals=True)
    assert (made.heard.tolist(), made.answered.tolist()) == ([True, False], [True, True])
    assert (made.error.tolist(), made.strays, list(made.unasked)) == ([0, 8], 0, [])
    made = ChecksumReply((1, 2), size)
    put(made, good + refusal)
    made.end()
    assert made.heard.tolist() == made.answered.tolist() == [True, False]
    assert (made.error.tolist(), made.strays, list(made.unasked)) == ([0, 0], 6, p.find_packets(refusal))


@pytest.mark.parametrize(
    ("code", "id", "data"),
    [(0, 2, b""), (8, 2, b"\0"), (8, 9, b""), (8, 1, b"")],
    ids=["without an error", "with data", "of another", "of one who sent data"],
)
def test_another_packet_is_no_refusal(code: int, id: int, data: bytes) -> None:
    other = p.instruction(id, code, data)
    made = reply((1, 2), 2, FIRST + other, refusals=True)
    assert made.heard.tolist() == made.answered.tolist() == [True, False]
    assert made.error.tolist() == [4, 0]
    assert (made.strays, list(made.unasked)) == (len(other), p.find_packets(other))


def test_the_first_refusal_of_a_device_counts() -> None:
    again = p.instruction(2, 16)
    made = reply((1, 2), 2, p.instruction(2, 8) + again, refusals=True)
    assert (made.answered.tolist(), made.error.tolist()) == ([False, True], [0, 8])
    assert (made.strays, list(made.unasked)) == (6, p.find_packets(again))


def test_the_echo_of_a_ping_is_no_refusal() -> None:
    ping = p.instruction(1, p.PING)
    made = reply((1,), 0, ping, (ping,), refusals=True)
    assert (made.answered.tolist(), made.strays) == ([False], 6)
    assert reply((1,), 0, ping + p.instruction(1, 0), (ping,), refusals=True).answered.tolist() == [True]
