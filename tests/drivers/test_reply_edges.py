"""Replies from untrusted bytes, edges: nothing of before is kept, nothing beyond what was received counts."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tests.support.reply_rig import IDS, SIZE, block, check_data, fast, give, plain
from twind_drivers.dynamixel import packet as p
from twind_drivers.dynamixel.replies import FastSyncReadReply, StatusReply

Kind = type[StatusReply | FastSyncReadReply]
BOTH = pytest.mark.parametrize(("kind", "sent"), [(StatusReply, plain), (FastSyncReadReply, fast)])
STRANGER = p.status(99, 0, block(99))
JUNK = bytes(range(1, 71))
WHOLE = 8 + len(IDS) * (SIZE + 4)  # bytes of a common reply


def joint(*data: bytes, errors: tuple[int, ...] = (0,) * len(IDS)) -> bytes:
    """A common reply with these data."""
    rows = list(zip(errors, IDS, data, strict=True))
    return b"".join(p.fast_status(rows, len(IDS) * (SIZE + 4) + 1))


def empty(reply: Any) -> None:
    assert not (reply.whole or reply.heard.any() or reply.answered.any())
    assert not (np.asarray(reply.error).any() or np.asarray(reply.data).any())
    assert (reply.strays, reply.first, tuple(reply.unasked)) == (0, b"", ())


# ------------------------------------------------------------------------------------- both kinds


@BOTH
def test_a_reply_is_empty_before_its_first_bytes(kind: Kind, sent: Callable[[], bytes]) -> None:
    empty(kind(IDS, SIZE))


@BOTH
@pytest.mark.parametrize("before", [b"", JUNK])
def test_nothing_is_left_of_a_reply_with_alerts(kind: Kind, sent: Callable[[], bytes], before: bytes) -> None:
    reply = kind(IDS, SIZE)
    alert = (p.ALERT,) * len(IDS)
    data = plain(error=p.ALERT) if kind is StatusReply else joint(*map(block, IDS), errors=alert)
    give(reply, before + data)
    assert reply.whole and reply.answered.all()
    assert reply.error.tolist() == list(alert)
    give(reply, b"")
    empty(reply)


@BOTH
def test_an_alert_beside_data_of_zeros_is_kept(kind: Kind, sent: Callable[[], bytes]) -> None:
    nothing = [bytes(SIZE)] * len(IDS)
    alert = (p.ALERT,) * len(IDS)
    rows = [p.status(id, p.ALERT, data) for id, data in zip(IDS, nothing, strict=True)]
    reply = kind(IDS, SIZE)
    assert give(reply, b"".join(rows) if kind is StatusReply else joint(*nothing, errors=alert))
    assert reply.error.tolist() == list(alert)
    assert reply.whole and not np.asarray(reply.data).any()
    assert reply.first == b"", "it was not searched for"


@BOTH
def test_a_packet_behind_the_last_byte_is_no_part_of_it(kind: Kind, sent: Callable[[], bytes]) -> None:
    reply = kind(IDS, SIZE)
    assert give(reply, sent() + STRANGER)
    assert reply.strays == len(STRANGER)
    assert [each.id for each in reply.unasked] == [99]
    assert reply.first == b""
    check_data(reply)


@BOTH
@pytest.mark.parametrize("chunk", [5, 4096])
def test_an_echo_before_a_reply_is_kept_as_its_first_bytes(
    kind: Kind, sent: Callable[[], bytes], chunk: int
) -> None:
    reply = kind(IDS, SIZE)
    echo = p.sync_read(IDS, 126, SIZE)
    assert give(reply, echo + sent() + STRANGER[:9], chunk)
    assert reply.first.startswith(echo)
    assert give(reply, sent())
    assert reply.first == b""


@BOTH
def test_as_many_devices_as_the_buffer_holds_may_be_read(kind: Kind, sent: Callable[[], bytes]) -> None:
    count, size = (64, 21) if kind is StatusReply else (60, 30)
    assert kind(range(count), size).expected == p.CAPACITY
    with pytest.raises(ValueError, match="more than 2048"):
        kind(range(count), size + 1)


# ------------------------------------------------------------------------------------- statuses


def test_a_single_damaged_status_is_no_reply() -> None:
    bad = bytearray(p.status(3, 0, block(3)))
    bad[12] ^= 1
    reply = StatusReply((3,), SIZE)
    assert not give(reply, bytes(bad))
    assert not reply.answered.any()
    assert reply.strays == len(bad)


@pytest.mark.parametrize("before", [b"", JUNK])
@pytest.mark.parametrize("error", [0, 7, p.ALERT, p.ALERT | 7])
def test_an_acknowledgement_is_complete_whatever_it_reports(error: int, before: bytes) -> None:
    reply = StatusReply((3,), 0)
    assert give(reply, before + p.status(3, error))
    assert reply.error.tolist() == [error]
    assert reply.heard.all() and reply.answered.all() and reply.whole
    assert bool(reply.first) is bool(before)


def test_an_error_with_data_of_another_length_is_the_answer_to_another_request() -> None:
    reply = StatusReply(IDS, SIZE)
    stray = p.status(3, 7, bytes(4))
    assert not give(reply, stray + plain(IDS[1:]))
    assert reply.answered.tolist() == [False, True, True, True]
    assert reply.strays == len(stray)


def test_the_beginning_of_a_packet_at_the_end_of_an_incomplete_reply_is_stray() -> None:
    reply = StatusReply(IDS, SIZE)
    for _ in range(2):
        give(reply, plain(IDS[:3]) + STRANGER[:9])
        assert reply.strays == 9
        give(reply, STRANGER[9:] + plain(IDS[:3]))
        assert reply.strays == len(STRANGER) - 9
        assert tuple(reply.unasked) == ()


# ------------------------------------------------------------------------------------- common replies


def test_blocks_of_an_earlier_reply_do_not_complete_a_shorter_one() -> None:
    reply = FastSyncReadReply(IDS, SIZE)
    give(reply, fast())
    assert reply.whole
    for count in range(len(IDS)):
        give(reply, fast()[: 8 + count * (SIZE + 4)])
        assert reply.heard.tolist() == [place < count for place in range(len(IDS))]
        give(reply, fast())


@pytest.mark.parametrize("part", range(1, 8))
def test_a_head_that_is_cut_by_the_end_of_a_chunk_is_found(part: int) -> None:
    reply = FastSyncReadReply(IDS, SIZE)
    noise = bytes(WHOLE - part)
    assert give(reply, noise + fast(), WHOLE)
    assert reply.whole
    assert reply.strays == len(noise)


def test_the_first_bytes_of_much_noise_are_kept_as_such() -> None:
    reply = FastSyncReadReply(IDS, SIZE)
    assert give(reply, JUNK + fast(), WHOLE)
    assert len(reply.first) > 50 and JUNK.startswith(reply.first)


def test_nothing_but_silence_is_no_stray() -> None:
    reply = FastSyncReadReply(IDS, SIZE)
    give(reply, b"")
    assert reply.strays == 0


def test_a_reply_with_a_damaged_last_block_is_done_at_once() -> None:
    bad = bytearray(fast())
    bad[-3] ^= 1
    reply = FastSyncReadReply(IDS, SIZE)
    assert give(reply, bytes(bad))
    assert reply.heard.tolist() == [True, True, True, False]
    check_data(reply)


def test_blocks_before_the_beginning_of_another_packet_are_kept() -> None:
    reply = FastSyncReadReply(IDS, SIZE)
    give(reply, fast()[:36] + p.HEADER)
    assert reply.heard.tolist() == [True, True, False, False]
    assert reply.strays == len(p.HEADER)


@pytest.mark.parametrize("payload", [0, 20, 300])
def test_a_reply_is_done_with_a_foreign_status_taken_out(payload: int) -> None:
    stranger = p.status(200, 0, bytes(payload))
    reply = FastSyncReadReply(IDS, SIZE)
    assert give(reply, fast()[:30] + stranger + fast()[30:])
    assert reply.whole
    assert reply.strays == len(stranger)
    check_data(reply)


def test_data_that_look_like_a_status_stay_data() -> None:
    data = p.status(9, 0)
    reply = FastSyncReadReply((3,), len(data))
    assert give(reply, b"".join(p.fast_status([(0, 3, data)], len(data) + 5)))
    assert reply.whole and reply.strays == 0
    assert reply.data[0].tobytes() == data


@pytest.mark.parametrize("length", [1, 0x700])
def test_a_header_within_data_is_no_packet_to_be_taken_out(length: int) -> None:
    """Beside it a foreign status is taken out, or the last block is damaged."""
    data = p.HEADER + bytes((9,)) + length.to_bytes(2, "little") + bytes(3)
    whole = joint(data, *map(block, IDS[1:]))
    stranger = p.status(200, 0, b"abc")
    reply = FastSyncReadReply(IDS, SIZE)
    give(reply, whole[:36] + stranger + whole[36:])
    assert reply.whole and reply.strays == len(stranger)
    assert reply.data[0].tobytes() == data
    bad = bytearray(whole)
    bad[-3] ^= 1
    give(reply, bytes(bad))
    assert reply.heard.tolist() == [True, True, True, False]
