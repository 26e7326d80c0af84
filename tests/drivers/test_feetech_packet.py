"""Feetech packets: the printed ones, round trips, and statuses found among other bytes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind_drivers.bus import WireRangeError
from twind_drivers.feetech.feetech_packet import FeetechInstruction, sync_read
from twind_drivers.feetech.feetech_registers import map_of_firmware, register_map
from twind_drivers.half_duplex import checksum_packet as p
from twind_drivers.half_duplex import goal_words
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
    (p.instruction(1, p.PING), "FF FF 01 02 01 FB"),
    (p.instruction(1, p.REG_WRITE, b"\x2a\0\x08"), "FF FF 01 05 04 2A 00 08 C3"),
    (p.instruction(p.BROADCAST, p.ACTION), "FF FF FE 02 05 FA"),
]


@pytest.mark.parametrize(("made", "printed"), GOLDEN, ids=[text for _, text in GOLDEN])
def test_packets_are_the_printed_ones(made: bytes, printed: str) -> None:
    assert made == bytes.fromhex(printed)


@given(IDS, st.integers(0, 63), DATA)
def test_a_packet_is_found_as_it_was_built(id: int, code: int, data: bytes) -> None:
    assert p.find_packets(p.instruction(id, code, data)) == [p.ChecksumPacket(id, code, data)]


@given(st.integers(-32767, 32767))
def test_sign_and_magnitude_come_back(value: int) -> None:
    assert from_word(to_word(value, 15, 2), 15) == value


def test_minus_zero_is_read_as_zero_and_never_written() -> None:
    assert from_word(0x8000, 15) == 0
    assert [to_word(value, 15, 2) for value in (0, -1, -10)] == [0, 0x8001, 0x800A]


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


@pytest.mark.parametrize(
    "text",
    [
        "FF FF FF 02 01 FD",  # id 255
        "FF FF 01 01 FD 00",  # no room for the error byte
        "FF FF 01 05 03 F6",  # not whole, and what is there has the sum of a whole one
    ],
)
def test_bytes_with_the_sum_of_a_packet_and_not_its_form_are_none(text: str) -> None:
    assert p.find_packets(bytes.fromhex(text)) == []


def test_a_packet_is_found_behind_one_more_byte_of_its_header() -> None:
    assert p.find_packets(b"\xff" + p.instruction(1, 3)) == [p.ChecksumPacket(1, 3, b"")]


def test_a_packet_to_all_devices_is_no_status() -> None:
    last, everybody = p.instruction(p.LAST_ID, 1), p.instruction(p.BROADCAST, 1)
    assert [each.id for each in p.find_packets(last + everybody)] == [253, 254]
    assert [each.id for each in p.find_packets(last + everybody, status=True)] == [253]


def test_a_found_packet_may_be_a_status_and_tells_its_error_and_its_bytes_on_the_wire() -> None:
    raw = p.instruction(1, 8, b"\x38")
    (found,) = p.find_packets(raw)
    assert (found.is_status, found.error, found.octets) == (True, 8, len(raw))


def test_a_sync_write_has_data_of_one_length() -> None:
    for data in ({}, {1: b"\0", 2: b"\0\0"}):
        with pytest.raises(ValueError, match="data of one length"):
            p.sync_write(42, data)


@pytest.mark.parametrize("big_endian", [False, True])
def test_goals_are_words_with_sign_and_magnitude(big_endian: bool) -> None:
    wide = np.full(2, 1000)
    words = GoalWords("arm", 42, (1, 2), (big_endian, False), -wide, wide)
    words.choose(np.array([True, True]))
    for goal, word in ((-0x100, 0x8100), (-1, 0x8001), (0, 0), (1, 1), (0x102, 0x102)):
        rows = {1: word.to_bytes(2, "big" if big_endian else "little"), 2: b"\0\0"}
        assert words.encode(np.array([goal, 0])) == p.sync_write(42, rows)


@pytest.mark.parametrize("short", ["lower", "upper"])
def test_bounds_of_another_number_of_devices_are_refused(short: str) -> None:
    bounds = {"lower": np.zeros(2, np.int64), "upper": np.ones(2, np.int64)}
    with pytest.raises(ValueError, match="bounds of 2 devices needed"):
        bounds_of("arm", 2, **(bounds | {short: bounds[short][:1]}))


@pytest.mark.parametrize("place", [0, 1])
def test_a_lower_bound_above_the_upper_one_of_any_device_is_refused(place: int) -> None:
    lower, upper = np.array([3, 4]), np.array([3, 4])
    assert [each.tolist() for each in bounds_of("arm", 2, lower, upper)] == [[3, 4], [3, 4]]
    lower[place] += 1
    with pytest.raises(ValueError, match=r"arm: lower bounds .* must not be above upper bounds"):
        bounds_of("arm", 2, lower, upper)


def words_of(bound: int) -> GoalWords:
    """Encoder of the goals of ids 1 and 2 within `bound` to both sides; it sends to both."""
    words = GoalWords("arm", 42, (1, 2), (False, True), np.full(2, -bound), np.full(2, bound))
    words.choose(np.array([True, True]))
    return words


@pytest.mark.parametrize("goal", [-0x8001, -0x8000, 0x8000, 0x10001])
def test_a_goal_that_no_word_holds_is_not_sent_whatever_the_bounds_permit(goal: int) -> None:
    words = words_of(1 << 20)
    for ticks, id in (([goal, 0], 1), ([0, goal], 2)):
        with pytest.raises(WireRangeError) as refused:
            words.encode(np.array(ticks))
        found = refused.value
        assert (found.port, found.id, found.value) == ("arm", id, goal)
        assert (found.lower, found.upper) == (-1 << 20, 1 << 20)
    assert words.encode(np.array([0x7FFF, -0x7FFF])) == p.sync_write(42, {1: b"\xff\x7f", 2: b"\xff\xff"})


def test_goals_in_a_packet_with_the_id_of_another_servo_are_not_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    def misdirected(address: int, data: dict[int, bytes]) -> bytes:
        return p.sync_write(address, {3 if id == 2 else id: each for id, each in data.items()})

    monkeypatch.setattr(goal_words, "sync_write", misdirected)
    words = words_of(10)
    with pytest.raises(WireRangeError) as refused:
        words.encode(np.array([5, 6]))
    assert (refused.value.id, refused.value.value) == (2, 6)


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize("place", [0, 1])
def test_a_goal_lies_within_its_bounds(place: int, side: int) -> None:
    words = words_of(10)
    ticks = np.zeros(2, np.int64)
    ticks[place] = 10 * side
    assert words.encode(ticks)
    ticks[place] += side
    with pytest.raises(WireRangeError) as refused:
        words.encode(ticks)
    found = refused.value
    assert (found.id, found.value, found.lower, found.upper) == (place + 1, 11 * side, -10, 10)


@pytest.mark.parametrize("ticks", [np.zeros(1, np.int64), np.zeros((2, 1), np.int64), np.zeros(2)])
def test_goals_are_whole_ticks_of_all_devices(ticks: np.ndarray) -> None:
    with pytest.raises(ValueError, match="arm: 2 whole ticks needed"):
        words_of(10).encode(ticks)


def test_goals_go_to_the_chosen_devices_alone_and_to_none_before_any_is_chosen() -> None:
    words = GoalWords("arm", 42, (1, 2), (False, False), np.full(2, -9), np.full(2, 9))
    ticks = np.array([5, 6])
    assert (words.encode(ticks), words.places) == (b"", [])
    words.choose(np.array([False, True]))
    assert (words.encode(ticks), words.places) == (p.sync_write(42, {2: b"\6\0"}), [1])
    words.choose(np.array([False, False]))
    assert (words.encode(ticks), words.places) == (b"", [])


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


def test_the_map_follows_from_the_firmware_alone() -> None:
    found = {
        row: map_of_firmware(*row).name for row in ((3, 6, 0), (3, 10, 0), (3, 43, 0), (0, 20, 1), (2, 45, 0))
    }
    assert list(found.values()) == ["sts", "sts", "hls", "scs", "smbl"]
    for row in ((3, 60, 0), (3, 10, 1), (9, 0, 0), (0, 20, 0)):
        assert not map_of_firmware(*row).driven
    assert {each.order for each in register_map("scs").registers.values()} == {"big"}
