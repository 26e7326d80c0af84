"""Recorded bytes as exchanges: requests, late replies, noise."""

import pytest

from twind.flight import EntryKind, FlightEntry
from twind.observe.replaying.recorded_exchanges import DeviceReply, asks, exchanges, packets
from twind_drivers.dynamixel import packet

ASK = packet.sync_read((1, 2), 128, 4)
FAST = packet.fast_sync_read((1, 2), 128, 4)
ONE = packet.status(1, 0, b"abcd")
TWO = packet.status(2, 0x80, b"efgh")
GOALS = packet.sync_write(116, {1: b"\x01\0\0\0", 2: b"\x02\0\0\0"})


def out(time: float, data: bytes) -> FlightEntry:
    return FlightEntry(time, EntryKind.OUT, 0, data)


def received_entry(time: float, data: bytes) -> FlightEntry:
    return FlightEntry(time, EntryKind.IN, 0, data)


def test_goals_and_question_of_one_write_are_one_exchange() -> None:
    (found,) = exchanges([out(1.0, GOALS + ASK), received_entry(1.002, ONE), received_entry(1.003, TWO)])
    assert found.asks == ASK
    assert [(each.id, each.address, each.data) for each in found.writes] == [
        (1, 116, b"\x01\0\0\0"),
        (2, 116, b"\x02\0\0\0"),
    ]
    assert found.told == (DeviceReply(1, 0, 128, b"abcd"), DeviceReply(2, 0x80, 128, b"efgh"))
    assert found.missed == ()
    assert [data for _, data in found.answers] == [ONE, TWO]
    assert [at for at, _ in found.answers] == pytest.approx([0.002, 0.003])


def test_noise_and_damaged_replies_give_no_values_and_are_kept() -> None:
    broken = bytearray(TWO)
    broken[-1] ^= 1
    found, _ = exchanges(
        [out(1.0, ASK), received_entry(1.002, b"\xff\x00\xfd" + ONE + bytes(broken)), out(1.01, ASK)]
    )
    assert [each.id for each in found.told] == [1]
    assert found.missed == (2,)
    assert b"".join(data for _, data in found.answers) == b"\xff\x00\xfd" + ONE + bytes(broken)


def test_devices_behind_a_gap_in_a_fast_reply_are_missed() -> None:
    whole = packet.fast_status([(0, 1, b"abcd"), (0, 2, b"efgh")], 17)
    found, last = exchanges([out(1.0, FAST), received_entry(1.002, whole[0]), out(1.01, FAST)])
    assert [each.id for each in found.told] == [1]
    assert found.missed == (2,)
    assert (last.asks, last.missed) == (b"", ()), "nobody knows what would have come after the end"


def test_bytes_waiting_at_the_next_request_belong_to_the_earlier_exchange() -> None:
    late = packet.status(2, 0, b"late")
    first, _ = exchanges(
        [out(1.0, ASK), received_entry(1.002, ONE), received_entry(1.01, late), out(1.01, ASK)]
    )
    assert first.answers[1] == (pytest.approx(0.006), late)
    first, _ = exchanges([out(1.0, ASK), received_entry(1.002, ONE + TWO), out(1.002, ASK)])
    assert first.answers[0][0] == pytest.approx(0.002), "the last answer of a whole reply is where it was"


def test_a_ping_reply_gives_model_and_firmware_at_their_addresses() -> None:
    (found,) = exchanges(
        [out(1.0, packet.ping(7)), received_entry(1.001, packet.status(7, 0, b"\xfc\x03\x2f"))]
    )
    assert found.told == (DeviceReply(7, 0, 0, b"\xfc\x03"), DeviceReply(7, 0, 6, b"\x2f"))


def test_bytes_before_the_first_question_belong_to_none() -> None:
    assert exchanges([received_entry(0.9, ONE)]) == []
    assert len(exchanges([received_entry(0.9, ONE), out(1.0, ASK)])) == 1


def test_a_write_is_cut_into_packets_as_they_are() -> None:
    assert list(packets(GOALS + ASK)) == [GOALS, ASK]
    assert asks(ASK) and asks(FAST) and not asks(GOALS)
    assert list(packets(b"no packet at all")) == []


def test_a_question_that_no_answer_fits_is_an_exchange_all_the_same() -> None:
    odd = packet.bulk_read({1: (132, 4), 2: (144, 2)})
    (found,) = exchanges([out(1.0, odd), received_entry(1.001, ONE)])
    assert found.asks == odd and found.told == () and found.missed == ()
