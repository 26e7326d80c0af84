"""Feetech packets: the printed ones, round trips, and statuses found among other bytes."""

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind_drivers.feetech.feetech_packet import FeetechInstruction, sync_read
from twind_drivers.feetech.feetech_registers import map_of_firmware, register_map
from twind_drivers.half_duplex import checksum_packet as p
from twind_drivers.half_duplex.checksum_reply import CAPACITY, ChecksumReply
from twind_drivers.half_duplex.goal_bounds import bounds_of
from twind_drivers.half_duplex.goal_words import GoalWords
from twind_drivers.half_duplex.signed_words import from_word, to_word

IDS = st.integers(0, p.LAST_ID)
DATA = st.binary(max_size=40)

GOLDEN = [
    (p.instruction(1, FeetechInstruction.PING), "FF FF 01 02 01 FB"),
    (p.read(1, 56, 2), "FF FF 01 04 02 38 02 BE"),
    (p.read(1, 56, 15), "FF FF 01 04 02 38 0F B1"),
    (p.write(1, 40, b"\1"), "FF FF 01 04 03 28 01 CE"),
    (p.write(p.BROADCAST, 40, b"\0"), "FF FF FE 04 03 28 00 D2"),
    (p.write(1, 55, b"\0"), "FF FF 01 04 03 37 00 C0"),
    (p.instruction(1, FeetechInstruction.REBOOT), "FF FF 01 02 08 F4"),
    (sync_read((1, 2), 56, 2), "FF FF FE 06 82 38 02 01 02 3C"),
    (p.sync_write(42, {1: b"\0\x08", 2: b"\0\x04"}), "FF FF FE 0A 83 2A 02 01 00 08 02 00 04 39"),
    (p.write(1, 42, register_map("sts")["goal_position"].encode(-10)), "FF FF 01 05 03 2A 0A 80 42"),
    (p.write(1, 31, register_map("sts")["homing_offset"].encode(-5)), "FF FF 01 05 03 1F 05 08 CA"),
    (p.write(1, 42, register_map("scs")["goal_position"].encode(511)), "FF FF 01 05 03 2A 01 FF CC"),
    (p.instruction(1, 0, b"\x09\x03"), "FF FF 01 04 00 09 03 EE"),
]


@pytest.mark.parametrize(("made", "printed"), GOLDEN, ids=[text for _, text in GOLDEN])
def test_packets_are_the_printed_ones(made: bytes, printed: str) -> None:
    assert made == bytes.fromhex(printed)


@given(IDS, st.integers(0, 63), DATA)
def test_a_packet_is_found_as_it_was_built(id: int, code: int, data: bytes) -> None:
    assert p.find_packets(p.instruction(id, code, data)) == [p.ChecksumPacket(id, code, data)]


@given(st.integers(-32767, 32767))
def test_sign_and_magnitude_come_back(value: int) -> None:
    assert from_word(to_word(value, 15), 15) == value


def test_minus_zero_is_zero_and_a_number_too_large_is_refused() -> None:
    assert from_word(0x8000, 15) == 0
    assert to_word(-10, 15) == 0x800A


@pytest.mark.parametrize(
    ("sign", "size", "least", "most"), [(11, 2, -2047, 2047), (None, 2, 0, 65535), (None, 1, 0, 255)]
)
def test_a_number_too_large_for_its_word_is_refused(
    sign: int | None, size: int, least: int, most: int
) -> None:
    for value in (least, most):
        assert from_word(to_word(value, sign, size), sign) == value
    for value in (least - 1, most + 1):
        with pytest.raises(OverflowError, match=f"{value} does not fit"):
            to_word(value, sign, size)


def test_a_packet_that_is_damaged_or_not_whole_is_not_found() -> None:
    good = p.instruction(1, 3, b"\x38\x02")
    damaged = good[:-1] + bytes((good[-1] ^ 1,))
    assert p.find_packets(damaged) == p.find_packets(good[:-1]) == []
    assert p.find_packets(damaged + good) == [p.ChecksumPacket(1, 3, b"\x38\x02")]


@pytest.mark.parametrize("big_endian", [False, True])
def test_goals_are_words_with_sign_and_magnitude(big_endian: bool) -> None:
    wide = np.full(2, 1000)
    words = GoalWords("arm", 42, (1, 2), (big_endian, False), -wide, wide)
    words.choose(np.array([True, True]))
    rows = {1: b"\x81\x00" if big_endian else b"\x00\x81", 2: b"\0\0"}
    assert words.encode(np.array([-0x100, 0])) == p.sync_write(42, rows)


@pytest.mark.parametrize("short", ["lower", "upper"])
def test_bounds_of_another_number_of_devices_are_refused(short: str) -> None:
    bounds = {"lower": np.zeros(2, np.int64), "upper": np.ones(2, np.int64)}
    with pytest.raises(ValueError, match="bounds of 2 devices needed"):
        bounds_of("arm", 2, **(bounds | {short: bounds[short][:1]}))


def reply(ids: Sequence[int], size: int, data: bytes, requests: Sequence[bytes] = ()) -> ChecksumReply:
    """The reply after these bytes."""
    made = ChecksumReply(ids, size, requests)
    made.receive_buffer()[: len(data)] = data
    made.take(len(data))
    made.end()
    return made


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
    waiting.receive_buffer()[: len(request)] = request
    assert not waiting.take(len(request))
    assert not reply((1,), 2, request, (request,)).heard.any()
    made = reply((1,), 2, request + p.instruction(1, 0, b"\x18\x05"), (request,))
    assert made.data[0].tolist() == [0x18, 0x05]
    assert made.unasked == [p.ChecksumPacket(1, 2, b"\x38\x02")]


def test_bytes_beyond_the_buffer_are_dropped_and_counted() -> None:
    made = ChecksumReply((1,), 2)
    for _ in range(3):
        room = made.receive_buffer()
        room[:] = bytes(len(room))
        made.take(len(room))
    good = p.instruction(1, 0, b"\x18\x05")
    made.receive_buffer()[: len(good)] = good
    assert made.take(len(good))
    made.end()
    assert (made.data[0].tolist(), made.strays) == ([0x18, 0x05], 3 * CAPACITY)


@given(st.integers(1, 20))
def test_whole_replies_have_no_strays_wherever_their_bytes_are_cut(size: int) -> None:
    ids = (1, 2, 3)
    made = ChecksumReply(ids, 2, [p.read(id, 56, 2) for id in ids])
    data = b"".join(p.instruction(id, 0, b"\x18\x05") for id in ids)
    for at in range(0, len(data), size):
        piece = data[at : at + size]
        made.receive_buffer()[: len(piece)] = piece
        made.take(len(piece))
    made.end()
    assert (made.whole, made.strays, list(made.unasked)) == (True, 0, [])


def test_the_weak_cases_of_the_checksum_are_sound_packets() -> None:
    """That is why a position must be plausible as well: low + high byte 256 has the sum of zero."""
    for position in (511, 2041, 4081):
        good = p.instruction(1, 0, position.to_bytes(2, "little"))
        lost = good[:5] + b"\0\0" + good[-1:]
        assert p.is_sound(lost, 0, len(lost)) is (sum(divmod(position, 256)) % 256 == 0)
    assert sum(divmod(511, 256)) % 256 == 0


@given(st.binary(max_size=300))
def test_no_bytes_raise(data: bytes) -> None:
    p.find_packets(data)
    reply((1, 2), 6, data, (p.read(1, 56, 6), p.read(2, 56, 6)))


def test_the_map_follows_from_the_firmware_alone() -> None:
    found = {
        row: map_of_firmware(*row).name for row in ((3, 6, 0), (3, 10, 0), (3, 43, 0), (0, 20, 1), (2, 45, 0))
    }
    assert list(found.values()) == ["sts", "sts", "hls", "scs", "smbl"]
    for row in ((3, 60, 0), (3, 10, 1), (9, 0, 0), (0, 20, 0)):
        assert not map_of_firmware(*row).driven
    assert {each.order for each in register_map("scs").registers.values()} == {"big"}
