"""Replies from untrusted bytes (RX_SHAPE): only the outstanding one is taken, and each sender is kept."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tests.support.examples import examples
from tests.support.reply_rig import IDS, SIZE, block, check_data, fast, give, plain
from twind_drivers.dynamixel import packet as p
from twind_drivers.dynamixel.crc import crc16
from twind_drivers.dynamixel.replies import FastSyncReadReply, StatusReply
from twind_drivers.half_duplex.pending_reply import PendingReply


@pytest.fixture(params=["plain", "fast"])
def whole(request: pytest.FixtureRequest) -> tuple[PendingReply, bytes]:
    return (
        (StatusReply(IDS, SIZE), plain())
        if request.param == "plain"
        else (FastSyncReadReply(IDS, SIZE), fast())
    )


@pytest.mark.parametrize("chunk", [1, 7, 4096])
def test_a_whole_reply_is_done_at_its_last_byte(whole: tuple[PendingReply, bytes], chunk: int) -> None:
    reply, data = whole
    assert not give(reply, data[:-1], chunk)
    assert give(reply, data, chunk)
    assert reply.heard.all()
    assert reply.strays == 0
    check_data(reply)


@given(garbage=st.binary(max_size=200), chunk=st.integers(1, 100))
@examples(60)
@pytest.mark.parametrize("kind", ["plain", "fast"])
def test_noise_before_a_reply_is_only_counted(kind: str, garbage: bytes, chunk: int) -> None:
    reply: PendingReply = StatusReply(IDS, SIZE) if kind == "plain" else FastSyncReadReply(IDS, SIZE)
    assert give(reply, garbage + (plain() if kind == "plain" else fast()), chunk)
    assert reply.heard.all()
    assert reply.strays == len(garbage)
    check_data(reply)


@given(st.lists(st.one_of(st.binary(max_size=80), st.just(plain()), st.just(fast())), max_size=80))
@examples(60)
@pytest.mark.parametrize("kind", [StatusReply, FastSyncReadReply])
def test_no_bytes_raise(kind: type[StatusReply | FastSyncReadReply], parts: list[bytes]) -> None:
    reply = kind(IDS, SIZE)
    give(reply, b"".join(parts), 300)
    check_data(reply)


def test_a_single_flipped_bit_never_yields_a_wrong_value() -> None:
    for at in range(8, 64):
        for make, data in ((StatusReply, plain()), (FastSyncReadReply, fast())):
            bad = bytearray(data)
            bad[at] ^= 0x10
            reply: PendingReply = make(IDS, SIZE)
            give(reply, bytes(bad))
            assert not reply.heard.all(), at
            check_data(reply)


def test_stuffed_rows_are_unstuffed() -> None:
    reply = StatusReply(IDS, SIZE)
    odd = b"\xff\xff\xfd\xff\xff\xfd\xfd\xff\xff\xfd"
    data = p.status(3, 0, block(3)) + p.status(7, 0, odd) + p.status(4, 0, odd) + p.status(250, 0, block(250))
    for chunk in (1, 9, 4096):
        assert give(reply, data, chunk)
        assert reply.heard.all()
        assert reply.data[1].tobytes() == reply.data[2].tobytes() == odd


def test_a_short_status_that_looks_whole_because_of_its_stuffing_is_refused() -> None:
    short = b"\xff\xff\xfd" + bytes(SIZE - 4)  # 9 bytes, 10 on the wire
    data = p.status(3, 0, short) + plain(IDS[1:])
    reply = StatusReply(IDS, SIZE)
    assert len(data) == reply.expected
    assert not give(reply, data)
    assert reply.heard.tolist() == [False, True, True, True]


@pytest.mark.parametrize(
    "stray",
    [
        p.status(9, 0, block(9)),  # an id nobody asked
        p.status(3, 0, block(3)[:4]),  # a late answer to another request
        p.status(3, 0, block(3) + b"\0"),
        p.status(3, 0x80),  # alert, but no data and no error
        p.sync_read(IDS, 126, SIZE),  # our own echo
    ],
)
def test_an_unrequested_packet_is_dropped_and_counted(stray: bytes) -> None:
    reply = StatusReply(IDS, SIZE)
    assert not give(reply, stray + plain(IDS[1:]))
    assert reply.heard.tolist() == [False, True, True, True]
    assert reply.strays == len(stray)


def test_a_second_answer_of_the_same_device_is_stray() -> None:
    reply = StatusReply(IDS, SIZE)
    twice = p.status(3, 0, bytes(SIZE))
    give(reply, plain(IDS[:3]) + twice + b"\0" * 21)
    assert reply.heard.tolist() == [True, True, True, False]
    assert reply.data[0].tobytes() == block(3)


def test_alerts_and_errors_are_kept() -> None:
    reply = StatusReply(IDS, SIZE)
    give(reply, plain(error=0x80))
    assert reply.error.tolist() == [0x80] * 4
    assert reply.heard.all()
    assert give(reply, p.status(3, 0x87) + plain(IDS[1:]) + bytes(10))
    assert reply.error.tolist() == [0x87, 0, 0, 0]
    assert reply.answered.all()
    assert not reply.heard[0]


def test_an_alert_alone_drops_no_data_of_a_common_reply() -> None:
    rows = [(p.ALERT if id == 7 else 0, id, block(id)) for id in IDS]
    reply = FastSyncReadReply(IDS, SIZE)
    assert give(reply, b"".join(p.fast_status(rows, len(IDS) * (SIZE + 4) + 1)))
    assert reply.error.tolist() == [0, p.ALERT, 0, 0]
    assert reply.heard.all() and reply.answered.all() and reply.whole
    check_data(reply)


MANY = tuple(range(1, 25))


def many(kind: type[StatusReply | FastSyncReadReply]) -> list[bytes]:
    """Return the bytes that each of 24 devices puts on the wire."""
    if kind is StatusReply:
        return [p.status(id, 0, block(id)) for id in MANY]
    return p.fast_status([(0, id, block(id)) for id in MANY], len(MANY) * (SIZE + 4) + 1)


@given(data=st.data())
@examples(150)
@pytest.mark.parametrize("kind", [StatusReply, FastSyncReadReply])
def test_a_damaged_reply_never_yields_a_wrong_value(
    kind: type[StatusReply | FastSyncReadReply], data: st.DataObject
) -> None:
    """Truncated, bits flipped, blocks lost or doubled, noise before, inside and behind, in any chunks."""
    pieces = [(place, piece) for place, piece in enumerate(many(kind))]
    for place in data.draw(st.lists(st.integers(0, 23), max_size=3)):  # lost
        pieces = [each for each in pieces if each[0] != place]
    for at in data.draw(st.lists(st.integers(0, 24), max_size=2)):
        pieces.insert(at, (-1, data.draw(st.binary(min_size=1, max_size=40))))
    stream = bytearray(b"".join(piece for _, piece in pieces))
    del stream[data.draw(st.integers(len(stream) // 2, len(stream))) :]
    for bit in data.draw(st.lists(st.integers(0, 8 * len(stream) - 1), max_size=3)) if stream else []:
        stream[bit // 8] ^= 1 << bit % 8
    reply = kind(MANY, SIZE)
    give(reply, bytes(stream), data.draw(st.integers(1, 400)))
    check_data(reply)
    assert reply.whole == bool(reply.heard.all())


@given(lost=st.sets(st.integers(1, 24), max_size=5), noise=st.binary(max_size=60), chunk=st.integers(1, 400))
@examples(60)
def test_every_intact_reply_is_accepted_within_its_transaction(
    lost: set[int], noise: bytes, chunk: int
) -> None:
    """Plain: all that are there. Fast: the prefix; noise before it costs nothing."""
    plain = StatusReply(MANY, SIZE)
    fast = FastSyncReadReply(MANY, SIZE)
    there = [piece for id, piece in zip(MANY, many(StatusReply), strict=True) if id not in lost]
    give(plain, noise + noise.join(there) + noise, chunk)
    assert set(np.array(MANY)[plain.heard].tolist()) == set(MANY) - lost
    first = min(lost, default=25)
    give(fast, noise + b"".join(many(FastSyncReadReply)[: first - 1]) + noise, chunk)
    assert set(np.array(MANY)[fast.heard].tolist()) == set(range(1, first))
    for reply in (plain, fast):
        check_data(reply)


@pytest.mark.parametrize("kind", [StatusReply, FastSyncReadReply])
@pytest.mark.parametrize(
    "babble",
    [b"\0", b"\xff", p.HEADER, p.HEADER + b"\xfe\x01\x05\x55", p.status(200, 0, b"abc"), p.ping(7)],
)
def test_endless_babble_never_fills_the_buffer(
    kind: type[StatusReply | FastSyncReadReply], babble: bytes
) -> None:
    reply = kind(MANY, SIZE)
    reply.start()
    for _ in range(300):
        room = reply.receive_buffer()
        assert len(room) > 0
        count = min(len(room), 300)
        room[:count] = (babble * 300)[:count]
        if reply.take(count):
            break
    reply.end()
    assert not reply.heard.any()


@pytest.mark.parametrize(
    "error", [p.StatusErrorCode.RESULT_FAIL, p.StatusErrorCode.ACCESS, p.ALERT | p.StatusErrorCode.DATA_RANGE]
)
@pytest.mark.parametrize("kind", [StatusReply, FastSyncReadReply])
def test_numbers_that_come_with_an_error_number_are_no_reading(
    kind: type[StatusReply | FastSyncReadReply], error: int
) -> None:
    """E-manual, "Error": the number says that the instruction was not carried out; the alert does not."""
    rows = [(error if id == 7 else p.ALERT, id, block(id)) for id in IDS]
    statuses = b"".join(p.status(id, number, data) for number, id, data in rows)
    joint = b"".join(p.fast_status(rows, len(IDS) * (SIZE + 4) + 1))
    reply = kind(IDS, SIZE)
    give(reply, statuses if kind is StatusReply else joint)
    assert reply.heard.tolist() == [True, False, True, True]
    assert reply.answered.all()
    assert not reply.whole
    assert reply.error.tolist() == [number for number, _, _ in rows]
    assert reply.strays == 0
    check_data(reply)
    give(reply, b"")
    assert not reply.answered.any()


def test_whole_sound_packets_that_are_no_part_of_a_reply_are_kept_aside() -> None:
    other = p.status(99, 0, b"abc")
    request = p.sync_read(IDS, 126, SIZE)
    for reply, data in ((StatusReply(IDS, SIZE), plain()), (FastSyncReadReply(IDS, SIZE), fast())):
        give(reply, other + data + request)
        assert [each.id for each in reply.unasked] == [99, p.BROADCAST]
        assert reply.whole
        give(reply, data)
        assert len(reply.unasked) == 0


def test_nothing_of_the_last_reply_is_left_in_the_next() -> None:
    for reply, data in ((StatusReply(IDS, SIZE), plain()), (FastSyncReadReply(IDS, SIZE), fast())):
        give(reply, data)
        give(reply, b"")
        assert not reply.heard.any()
        assert not np.asarray(reply.data).any()
        assert not np.asarray(reply.error).any()


def test_strays_are_counted_once_and_their_pieces_make_no_packet_across_two_replies() -> None:
    stranger = p.status(99, 0, block(99))
    for reply, data in ((StatusReply(IDS, SIZE), plain()), (FastSyncReadReply(IDS, SIZE), fast())):
        for _ in range(3):
            give(reply, data + stranger[:9])
            assert (reply.strays, tuple(reply.unasked)) == (9, ())
            give(reply, stranger[9:] + data)
            assert (reply.strays, tuple(reply.unasked)) == (len(stranger) - 9, ())


def test_a_fast_reply_of_others_is_not_ours() -> None:
    reply = FastSyncReadReply((3, 7, 4, 251), SIZE)
    give(reply, fast())
    assert reply.heard.tolist() == [True, True, True, False]


@pytest.mark.parametrize("garbled", range(5))
@pytest.mark.parametrize("size", [0, 1, 10, 27])
def test_bytes_of_a_common_reply_that_were_garbled_for_the_later_devices_too_are_no_reading(
    garbled: int, size: int
) -> None:
    """Two devices of one id speak at once: the later ones compute their CRCs over what they received."""
    ids = (3, 4, 7, 8, 200)
    reply = FastSyncReadReply(ids, size)
    length = (len(ids) * (size + 4) + 1).to_bytes(2, "little")
    data = p.HEADER + bytes((p.BROADCAST,)) + length + bytes((p.STATUS,))
    for place, id in enumerate(ids):
        data += bytes((0, id)) + bytes(size)
        data += (crc16(data) ^ (0x0810 if place == garbled else 0)).to_bytes(2, "little")
    give(reply, data)
    assert reply.heard.tolist() == [place < garbled for place in range(len(ids))]


def test_a_reply_that_cannot_fit_is_refused_when_asked() -> None:
    for make in (StatusReply, FastSyncReadReply):
        with pytest.raises(ValueError, match="request fewer"):
            make(range(200), 35)


@given(at=st.integers(8, len(fast())), payload=st.binary(max_size=40), chunk=st.integers(1, 120))
@example(at=len(fast()) - 1, payload=b"", chunk=1)  # as many bytes as were asked for end within its header
@example(at=len(fast()) - 3, payload=b"", chunk=1)
def test_a_foreign_status_inside_a_common_reply_costs_no_device_its_own(
    at: int, payload: bytes, chunk: int
) -> None:
    """However it is cut into pieces; the same between two statuses of a plain one."""
    stranger = p.status(200, 0, payload)
    row = at // len(p.status(3, 0, block(3))) * len(p.status(3, 0, block(3)))
    for reply, data, place in (
        (FastSyncReadReply(IDS, SIZE), fast(), at),
        (StatusReply(IDS, SIZE), plain(), row),
    ):
        give(reply, data[:place] + stranger + data[place:], chunk)
        assert reply.heard.all()
        check_data(reply)
        if place < len(data):  # else it may be done before
            assert reply.strays == len(stranger)
            assert [(each.id, each.data) for each in reply.unasked] == [(200, payload)]
