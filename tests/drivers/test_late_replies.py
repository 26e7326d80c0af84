"""Replies that come after their transaction: which request they answer, and how late they are."""

import pytest

from twind_drivers.dynamixel.packet import Framer, Packet, read, status
from twind_drivers.dynamixel.replies import StatusReply
from twind_drivers.half_duplex.late_replies import REMEMBERED, LateReplies


def packets(*rows: tuple[int, int]) -> list[Packet]:
    """Status packets of (id, data bytes)."""
    return list(Framer(status=None).feed(b"".join(status(id, 0, bytes(size)) for id, size in rows)))


def ended(*rows: tuple[int, int], ids: tuple[int, ...] = (1, 2), size: int = 4) -> StatusReply:
    """A reply of `size` bytes from each of `ids`, of which `rows` came in time."""
    reply = StatusReply(ids, size)
    data = b"".join(status(id, 0, bytes(length)) for id, length in rows)
    reply.receive_buffer()[: len(data)] = data
    reply.take(len(data))
    reply.end()
    return reply


@pytest.fixture
def late() -> LateReplies:
    return LateReplies()


def test_a_missed_reply_is_measured_from_its_request(late: LateReplies) -> None:
    late.record(ended((1, 4)), sent=10.0)
    assert late and late.ids == {2}
    late.measure(packets((2, 4)), now=10.016)
    assert list(late.delays) == pytest.approx([0.016])


def test_the_length_distinguishes_requests_and_the_older_one_is_given_up(late: LateReplies) -> None:
    late.record(ended(ids=(2,), size=4), sent=10.0)
    late.record(ended(ids=(2,), size=6), sent=10.01)
    late.measure(packets((2, 6), (2, 4)), now=10.03)  # the second one would be out of order
    assert list(late.delays) == pytest.approx([0.02])


def test_a_reply_of_another_length_or_device_is_not_late(late: LateReplies) -> None:
    late.record(ended(ids=(2,)), sent=10.0)
    late.measure(packets((2, 5), (3, 4)), now=10.01)
    assert not late.delays


def test_two_devices_with_one_id_are_not_late(late: LateReplies) -> None:
    """Their first collision is a missed reply; then both answer one request, and one of these is a stray."""
    late.record(ended(ids=(2,)), sent=10.0)
    for cycle in range(1, 100):
        reply = ended((2, 4), (2, 4), ids=(2,))
        late.measure(reply.unasked, now=10.0 + cycle * 0.01)
        late.record(reply, sent=10.0 + cycle * 0.01)
        late.measure(packets((2, 4)), now=10.0 + cycle * 0.01 + 0.005)
    assert len(late.delays) <= 1


def test_a_missed_reply_is_forgotten_after_a_second_and_few_are_kept(late: LateReplies) -> None:
    late.record(ended(ids=(2,)), sent=10.0)
    late.record(ended((1, 4), ids=(1,)), sent=10.0 + REMEMBERED)
    assert not late
    late.measure(packets((2, 4)), now=11.0)
    assert not late.delays
    for count in range(2 * 64):
        late.record(ended(ids=(2,)), sent=20.0 + count)
        late.measure(packets((2, 4)), now=20.01 + count)
    assert len(late.delays) == 64


def test_a_missed_reply_is_forgotten_after_a_second_also_beside_a_newer_one(late: LateReplies) -> None:
    late.record(ended(ids=(2,)), sent=10.0)
    late.record(ended(ids=(2,), size=6), sent=10.5)
    late.record(ended((1, 4), ids=(1,)), sent=10.0 + REMEMBERED)
    late.measure(packets((2, 4)), now=11.0)
    assert not late.delays
    late.measure(packets((2, 6)), now=11.02)
    assert list(late.delays) == pytest.approx([0.52])


def test_late_replies_to_equal_requests_are_measured_each_from_its_own(late: LateReplies) -> None:
    for sent in (10.0, 10.01):
        late.record(ended(ids=(2,)), sent=sent)
    for now in (10.02, 10.03):
        late.measure(packets((2, 4)), now=now)
    assert list(late.delays) == pytest.approx([0.02, 0.02])


def test_a_reply_in_time_ends_the_wait_for_earlier_ones(late: LateReplies) -> None:
    late.record(ended(ids=(2,)), sent=10.0)
    late.record(ended((2, 4), ids=(2,)), sent=10.01)
    late.measure(packets((2, 4)), now=10.02)
    assert not late.delays


def test_a_request_of_another_master_is_no_late_reply(late: LateReplies) -> None:
    late.record(ended(ids=(2,), size=3), sent=10.0)
    [request] = Framer(status=None).feed(read(2, 132, 4))
    assert len(request.data) == 3
    late.measure([request], now=10.01)
    assert not late.delays
