"""A roll call: everybody in any order, however garbled, and nobody who was not heard whole.

Sources: e-manual, protocol 2.0, "Ping" (all answer a ping to 254, in the order of their ids); the time slots:
Dynamixel2Arduino #106 and the window of DynamixelSDK's `broadcastPing`.
"""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind_drivers.dynamixel import packet
from twind_drivers.dynamixel.broadcast_ping import BroadcastPingReply

IDS = st.lists(st.integers(0, 252), unique=True, max_size=30)


def answer(id: int, model: int = 1020, firmware: int = 47, error: int = 0) -> bytes:
    return packet.status(id, error, model.to_bytes(2, "little") + bytes((firmware,)))


def give(call: BroadcastPingReply, data: bytes, chunk: int = 7) -> bool:
    """Hand `data` over in chunks; True when the call says that it is done."""
    done = False
    for at in range(0, len(data), chunk):
        piece = data[at : at + chunk]
        call.receive_buffer()[: len(piece)] = piece
        done = call.take(len(piece))
    return done


def present(call: BroadcastPingReply) -> list[int]:
    call.end()
    return [id for id in call.ids if call.heard[id]]


@given(IDS, st.integers(1, 600))
def test_every_ping_reply_is_decoded_in_any_order(ids: list[int], chunk: int) -> None:
    call = BroadcastPingReply()
    assert not give(call, b"".join(answer(id, 1020 + id, id) for id in ids), chunk)
    assert present(call) == sorted(ids)
    for id in ids:
        assert call.data[id].tobytes() == (1020 + id).to_bytes(2, "little") + bytes((id,))
    assert call.strays == 0
    assert call.twice == set()


@given(IDS.filter(bool), st.data())
def test_noise_between_ping_replies_hides_no_device_and_is_counted(
    ids: list[int], data: st.DataObject
) -> None:
    call = BroadcastPingReply()
    noise = [data.draw(st.binary(max_size=5)) for _ in ids]
    give(call, b"".join(dirt + answer(id) for dirt, id in zip(noise, ids, strict=True)))
    assert set(present(call)) == set(ids)
    assert call.strays == sum(map(len, noise))


@given(st.binary(max_size=600))
def test_no_noise_raises_or_grows_what_is_held(noise: bytes) -> None:
    call = BroadcastPingReply()
    for _ in range(20):
        give(call, noise, 64)
    assert len(call.receive_buffer()) == 4096
    call.end()
    assert call.strays <= 20 * len(noise)


@given(IDS.filter(bool), st.integers(0, 13), st.integers(0, 7))
def test_an_answer_with_a_flipped_bit_counts_as_none(ids: list[int], place: int, bit: int) -> None:
    packets = [bytearray(answer(id)) for id in ids]
    packets[0][place] ^= 1 << bit
    call = BroadcastPingReply()
    give(call, b"".join(packets))
    assert set(present(call)) == set(ids[1:])


def test_only_the_window_ends_it() -> None:
    call = BroadcastPingReply()
    assert not give(call, b"".join(answer(id) for id in range(253)))
    assert len(present(call)) == 253
    assert call.window == pytest.approx(253 * 0.003)


def test_the_window_reaches_to_the_last_id_that_is_asked_for() -> None:
    assert BroadcastPingReply(20).window == pytest.approx(21 * 0.003)


def test_a_second_answer_of_one_id_is_named_and_changes_nothing() -> None:
    call = BroadcastPingReply()
    give(call, answer(5, 1020) + answer(5, 1060))
    assert present(call) == [5]
    assert call.twice == {5}
    assert call.data[5].tobytes()[:2] == (1020).to_bytes(2, "little")
    assert call.strays == 14


def test_a_status_that_is_no_answer_to_a_ping_is_stray() -> None:
    call = BroadcastPingReply()
    give(call, packet.status(4, 0, bytes(10)) + packet.status(4, 7))
    assert present(call) == []
    assert call.strays == 21 + 11
    assert call.twice == set()


def test_the_alert_of_a_device_is_kept() -> None:
    call = BroadcastPingReply()
    give(call, answer(4, error=0x80))
    assert present(call) == [4]
    assert call.error[4] == 0x80


def test_a_call_can_be_used_again() -> None:
    call = BroadcastPingReply()
    give(call, answer(5) + answer(5) + b"\xff\xff\xfd")
    call.end()
    call.start()
    assert (call.strays, call.twice, present(call)) == (0, set(), [])


@pytest.mark.parametrize("id", [-1, 253, 254, 255])
def test_a_reserved_id_is_refused_as_the_last_slot(id: int) -> None:
    with pytest.raises(ValueError, match=f"id {id} is not"):
        BroadcastPingReply(id)
