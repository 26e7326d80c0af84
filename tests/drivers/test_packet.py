"""Packets: the vendor's golden ones, stuffing both ways, and finding packets in any stream."""

from itertools import product

import pytest
from dynamixel_sdk.protocol2_packet_handler import Protocol2PacketHandler
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import examples
from twind_drivers.dynamixel import packet as p
from twind_drivers.dynamixel.crc import crc16
from twind_drivers.dynamixel.packet import Framer, Instruction, Packet

# name -> (bytes of the e-manual or recomputed by hand, what we build)
POSITION = (512).to_bytes(4, "little")
GOLDEN = {
    "ping": ("FF FF FD 00 01 03 00 01 19 4E", p.ping(1)),
    "ping all": ("FF FF FD 00 FE 03 00 01 31 42", p.ping(0xFE)),
    "ping status": ("FF FF FD 00 01 07 00 55 00 06 04 26 65 5D", p.status(1, 0, b"\x06\x04\x26")),
    "ping status of 2": ("FF FF FD 00 02 07 00 55 00 06 04 26 6F 6D", p.status(2, 0, b"\x06\x04\x26")),
    "read": ("FF FF FD 00 01 07 00 02 84 00 04 00 1D 15", p.read(1, 132, 4)),
    "read status": ("FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0", p.status(1, 0, b"\xa6\0\0\0")),
    "write": ("FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89", p.write(1, 116, POSITION)),
    "status ok": ("FF FF FD 00 01 04 00 55 00 A1 0C", p.status(1, 0)),
    "reg write": (
        "FF FF FD 00 01 09 00 04 68 00 C8 00 00 00 AE 8E",
        p.instruction(1, Instruction.REG_WRITE, b"\x68\0\xc8\0\0\0"),
    ),
    "action": ("FF FF FD 00 01 03 00 05 02 CE", p.instruction(1, Instruction.ACTION)),
    "factory reset": (
        "FF FF FD 00 01 04 00 06 01 A1 E6",
        p.instruction(1, Instruction.FACTORY_RESET, b"\x01"),
    ),
    "reboot": ("FF FF FD 00 01 03 00 08 2F 4E", p.reboot(1)),
    "clear": (
        "FF FF FD 00 01 08 00 10 01 44 58 4C 22 B1 DC",
        p.instruction(1, Instruction.CLEAR, b'\x01DXL"'),
    ),
    "backup": (
        "FF FF FD 00 01 08 00 20 01 43 54 52 4C 16 F5",
        p.instruction(1, Instruction.BACKUP, b"\x01CTRL"),
    ),
    "restore": (  # the manual prints 92 F5
        "FF FF FD 00 01 08 00 20 02 43 54 52 4C 9E F5",
        p.instruction(1, Instruction.BACKUP, b"\x02CTRL"),
    ),
    "sync read": ("FF FF FD 00 FE 09 00 82 84 00 04 00 01 02 CE FA", p.sync_read((1, 2), 132, 4)),
    "sync read status": ("FF FF FD 00 02 08 00 55 00 1F 08 00 00 BA BE", p.status(2, 0, b"\x1f\x08\0\0")),
    "sync write": (
        "FF FF FD 00 FE 11 00 83 74 00 04 00 01 96 00 00 00 02 AA 00 00 00 82 87",
        p.sync_write(116, {1: b"\x96\0\0\0", 2: b"\xaa\0\0\0"}),
    ),
    "bulk read": (
        "FF FF FD 00 FE 0D 00 92 01 90 00 02 00 02 92 00 01 00 1A 05",
        p.instruction(0xFE, Instruction.BULK_READ, bytes.fromhex("01 9000 0200 02 9200 0100")),
    ),
    "bulk status of 1": ("FF FF FD 00 01 06 00 55 00 77 00 C3 69", p.status(1, 0, b"\x77\0")),
    "bulk status of 2": ("FF FF FD 00 02 05 00 55 00 24 8B A9", p.status(2, 0, b"\x24")),
    "bulk write": (
        "FF FF FD 00 FE 10 00 93 01 20 00 02 00 A0 00 02 1F 00 01 00 50 B7 68",
        p.instruction(0xFE, Instruction.BULK_WRITE, bytes.fromhex("01 2000 0200 A000 02 1F00 0100 50")),
    ),
    "fast sync read": (
        "FF FF FD 00 FE 0A 00 8A 84 00 04 00 03 07 04 20 F2",
        p.fast_sync_read((3, 7, 4), 132, 4),
    ),
    "fast sync reply": (
        "FF FF FD 00 FE 19 00 55 00 03 A6 00 00 00 84 08 00 07 1F 08 00 00 16 CA 00 04 FF 03 00 00 D1 9E",
        b"".join(
            p.fast_status([(0, 3, b"\xa6\0\0\0"), (0, 7, b"\x1f\x08\0\0"), (0, 4, b"\xff\x03\0\0")], 25)
        ),
    ),
    "fast bulk request": (  # the manual prints 20 F2
        "FF FF FD 00 FE 12 00 9A 03 84 00 04 00 07 7C 00 02 00 04 92 00 01 00 DA 2D",
        p.instruction(
            0xFE, Instruction.FAST_BULK_READ, bytes.fromhex("03 8400 0400 07 7C00 0200 04 9200 0100")
        ),
    ),
    "fast bulk reply": (
        "FF FF FD 00 FE 14 00 55 00 03 A6 00 00 00 67 A4 00 07 A5 01 24 74 00 04 1F D9 C1",
        b"".join(p.fast_status([(0, 3, b"\xa6\0\0\0"), (0, 7, b"\xa5\x01"), (0, 4, b"\x1f")], 20)),
    ),
    "fast sync read of P": (
        "FF FF FD 00 FE 09 00 8A 44 02 04 00 01 02 72 F2",
        p.fast_sync_read((1, 2), 580, 4),
    ),
    "fast sync reply of P": (
        "FF FF FD 00 FE 11 00 55 00 01 D0 07 00 00 0C 83 00 02 09 00 00 00 11 40",
        b"".join(p.fast_status([(0, 1, b"\xd0\x07\0\0"), (0, 2, b"\x09\0\0\0")], 17)),
    ),
    "stuffed write": (
        "FF FF FD 00 01 0A 00 03 74 00 FF FF FD FD 00 21 E7",
        p.write(1, 116, b"\xff\xff\xfd\0"),
    ),
    "stuffed write of a stuffed look": (
        "FF FF FD 00 01 0A 00 03 74 00 FF FF FD FD FD 2C 65",
        p.write(1, 116, b"\xff\xff\xfd\xfd"),
    ),
    "two patterns": (
        "FF FF FD 00 01 0D 00 03 66 00 FF FF FD FD FF FF FD FD 33 F8",
        p.write(1, 102, b"\xff\xff\xfd\xff\xff\xfd"),
    ),
    "stuffed status": (
        "FF FF FD 00 01 0B 00 55 00 FF FF FD FD FF FF FF 58 6C",
        p.status(1, 0, b"\xff\xff\xfd\xff\xff\xff"),
    ),
    "alert": ("FF FF FD 00 01 04 00 55 80 A2 8F", p.status(1, 0x80)),
    "access error": ("FF FF FD 00 01 04 00 55 07 B0 8C", p.status(1, 7)),
    "range error": ("FF FF FD 00 01 04 00 55 04 BA 8C", p.status(1, 4)),
    "watchdog": ("FF FF FD 00 01 06 00 03 62 00 05 68 E4", p.write(1, 98, b"\x05")),
    "torque on": (
        "FF FF FD 00 FE 0B 00 83 40 00 01 00 01 01 02 01 C7 64",
        p.sync_write(64, {1: b"\x01", 2: b"\x01"}),
    ),
}


def test_we_build_the_golden_packet() -> None:
    for name, (golden, ours) in GOLDEN.items():
        assert ours.hex(" ").upper() == golden, name


@pytest.mark.parametrize(
    "name", [name for name in GOLDEN if not name.startswith(("fast sync reply", "fast bulk reply"))]
)
def test_a_golden_packet_is_found_after_any_noise(name: str) -> None:
    data = GOLDEN[name][1]
    status = data[7] == p.STATUS
    for garbage in (b"", b"\xff", b"\xff\xff\xfd", b"\xff\xff\xfd\x00", b"\xff\xff\xfd\x00\x01\xf0\x00\x55"):
        framer = Framer(status=status)
        [found] = framer.feed(garbage + data)
        assert (found.id, found.instruction) == (data[4], data[7])
        assert framer.discarded == len(garbage)
        assert len(framer) == 0


# ------------------------------------------------------------------------------------------- stuffing

ALPHABET = (0xFF, 0xFD, 0x00, 0x55)


def words(longest: int) -> list[bytes]:
    return [bytes(word) for length in range(longest + 1) for word in product(ALPHABET, repeat=length)]


def check_identity(data: bytes) -> None:
    stuffed = p.stuff(data)
    assert p.unstuff(stuffed) == data
    assert p.HEADER not in stuffed
    assert stuffed.count(p.PATTERN) == stuffed.count(p.STUFFED)


def test_unstuffing_undoes_stuffing_for_every_short_word_of_the_alphabet() -> None:
    for data in words(6):
        check_identity(data)
        framer = Framer(status=True)
        assert framer.feed(p.status(7, 0xFF, data)) == [Packet(7, 0x55, b"\xff" + data)]
        assert framer.discarded == 0


@given(st.lists(st.sampled_from([0xFF, 0xFD, 0x00, 0x55, 0x07]), max_size=60).map(bytes))
@examples(200)
def test_stuffing_equals_what_the_vendors_sdk_returns(params: bytes) -> None:
    body = bytes((3,)) + params
    raw = [*p.HEADER, 1, *(len(body) + 2).to_bytes(2, "little"), *body, 0, 0]
    theirs = bytes(Protocol2PacketHandler().addStuffing(raw))
    ours = p.instruction(1, 3, params)
    assert ours[:-2] == theirs[:-2]
    assert crc16(ours[:-2]) == int.from_bytes(ours[-2:], "little")


def test_an_id_that_no_packet_may_have_is_refused() -> None:
    for id in (-1, 253, 255, 256):
        with pytest.raises(ValueError, match=f"id {id}"):
            p.ping(id)
    with pytest.raises(ValueError, match="one size"):
        p.sync_write(64, {1: b"\0", 2: b"\0\0"})


def test_an_error_byte_is_explained() -> None:
    assert "EEPROM" in p.explain(7)
    assert "alert" in p.explain(0x80)
    assert "no error" in p.explain(0x80)
    assert "number 99" in p.explain(99)


# ------------------------------------------------------------------------------- the manual's numbers


@pytest.mark.parametrize(
    ("number", "word"),
    [
        (1, "carried out"),
        (2, "unknown instruction"),
        (3, "wrong CRC"),
        (4, "watchdog"),
        (5, "fewer bytes"),
        (6, "limit register"),
        (7, "read-only"),
    ],
)
def test_each_error_number_of_the_manual_has_its_own_words(number: int, word: str) -> None:
    assert word in p.explain(number)
    assert "alert" not in p.explain(number)
    assert word in p.explain(number | 0x80) and "alert" in p.explain(number | 0x80)


def test_error_numbers_and_codes_are_the_manuals() -> None:
    names = ("NONE", "RESULT_FAIL", "INSTRUCTION", "CRC", "DATA_RANGE", "DATA_LENGTH", "DATA_LIMIT", "ACCESS")
    assert [p.StatusErrorCode[name] for name in names] == list(range(8))
    assert Instruction.STATUS == p.STATUS == 0x55
    assert p.ALERT == 0x80


def test_the_overheads_are_those_of_packets_without_anything() -> None:
    assert len(p.ping(1)) == p.OVERHEAD == 10
    assert len(p.status(1, 0)) == p.STATUS_OVERHEAD == 11


def test_a_bulk_read_asks_each_device_for_its_own_block() -> None:
    assert p.bulk_read({1: (144, 2), 2: (146, 1)}).hex(" ").upper() == GOLDEN["bulk read"][0]
    spans = {3: (132, 4), 7: (124, 2), 4: (146, 1)}
    assert p.fast_bulk_read(spans) == p.instruction(
        0xFE, 0x9A, bytes.fromhex("03 8400 0400 07 7C00 0200 04 9200 0100")
    )


def test_a_status_without_params_has_no_error_and_no_data() -> None:
    empty = Packet(1, 0x55, b"")
    full = Packet(1, 0x55, b"\x80\x01\x02")
    assert (empty.error, empty.data) == (0, b"")
    assert (full.error, full.data) == (0x80, b"\x01\x02")


@pytest.mark.parametrize("params", [b"", b"\1\2", b"\xff\xff\xfd\1"])
def test_a_packet_counts_the_bytes_of_its_whole_frame(params: bytes) -> None:
    frame = p.instruction(1, Instruction.WRITE, params)
    [packet] = Framer(status=None).feed(frame)
    assert packet.octets == len(frame)


@pytest.mark.parametrize(
    ("status", "found"), [(True, [False, True]), (False, [True, False]), (None, [True, True])]
)
def test_packets_are_found_by_whether_they_are_statuses(status: bool | None, found: list[bool]) -> None:
    ping = p.instruction(1, Instruction.PING)
    reply = p.status(1, 0, b"\1\2\3")
    packets = p.find_packets(b"\0" + ping + reply, status=status)
    assert packets == [
        packet
        for packet, kept in zip((Packet(1, 1, b""), Packet(1, 0x55, b"\0\1\2\3")), found, strict=True)
        if kept
    ]
    assert [packet.is_status for packet in packets] == [
        each for each, kept in zip((False, True), found, strict=True) if kept
    ]
