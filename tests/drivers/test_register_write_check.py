"""Last check of a command's bytes, framing `FF FF`: what passes, and what is refused as what."""

import pytest

from twind_drivers.bus import WireRangeError
from twind_drivers.half_duplex import checksum_packet as p
from twind_drivers.half_duplex.register_table import RegisterTable, parse_registers
from twind_drivers.half_duplex.register_write_check import RegisterWriteCheck

REBOOT = 0x08
OFF = p.write(p.BROADCAST, 40, b"\0")
TABLE = RegisterTable(
    "servo",
    parse_registers(
        "id 5 1 - 0 253\n"
        "offset 31 2 11 -2047 2047\n"
        "limit 33 1 - 1 5\n"
        "torque_enable 40 1 - 0 255\n"
        "acceleration 41 1 - 0 100\n"
        "goal_position 42 2 15 -30000 30000\n"
        "model 44 1 - 0 0\n"
        "soft_goal 60 2 15 -9 9",
        kept_end=40,
    ),
)


def check() -> RegisterWriteCheck:
    """Check of ids 1 and 3, whose goals end at -10 and 10, and at 5 and 20; the offset is volatile."""
    goals = {1: (-10, 10), 3: (5, 20)}
    return RegisterWriteCheck("arm", {1: TABLE, 3: TABLE}, goals, OFF, volatile=(31,), bare=(REBOOT,))


def word(value: int) -> bytes:
    """A goal's bytes."""
    return TABLE["goal_position"].encode(value)


def refused(data: bytes, judge: RegisterWriteCheck | None = None) -> tuple[int, float, float, float, str]:
    """Id, value and bounds that the error names, and what it calls them."""
    with pytest.raises(WireRangeError) as error:
        (judge or check()).judge(data)
    found = error.value
    assert found.port == "arm"
    what = str(found).partition(f"id {found.id}: ")[2].partition(f" {found.value} outside")[0]
    return found.id, found.value, found.lower, found.upper, what


@pytest.mark.parametrize(
    "data",
    [
        OFF,
        OFF + p.write(1, 41, b"\0") + OFF,
        p.write(1, 42, word(-10)),
        p.write(3, 42, word(20)),
        p.write(1, 40, b"\1" + b"\x64" + word(10)),
        p.write(1, 31, TABLE["offset"].encode(-2047)),
        p.sync_write(42, {1: word(10), 3: word(5)}),
        p.sync_write(40, {1: b"\1\x64" + word(1), 3: b"\0\0" + word(6)}),
        p.instruction(3, REBOOT),
        p.instruction(p.BROADCAST, p.SYNC_WRITE, b"\x2a\2"),  # no rows
    ],
    ids=lambda data: data.hex(),
)
def test_a_permitted_write_passes(data: bytes) -> None:
    check().judge(data)


@pytest.mark.parametrize("data", [b"", b"\0", OFF + b"\0", b"\0" + OFF, OFF[:-1], OFF + OFF[:5]])
def test_stray_bytes_beside_a_packet_are_not_sent(data: bytes) -> None:
    assert refused(data) == (p.BROADCAST, len(data), 0, 0, "stray bytes in a packet")


@pytest.mark.parametrize(("id", "value"), [(1, -11), (1, 11), (3, 4), (3, 21)])
def test_a_goal_beyond_the_range_of_its_servo_is_not_sent(id: int, value: int) -> None:
    lower, upper = check().goals[id]
    for data in (
        p.write(id, 42, word(value)),
        p.write(id, 40, b"\0\0" + word(value)),
        OFF + p.write(id, 42, word(value)),
        p.sync_write(42, {1: word(8), 3: word(8), id: word(value)}),
    ):
        assert refused(data) == (id, value, lower, upper, "goal position")


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (p.write(1, 40, b"\2"), (1, 2, 0, 1, "torque enable")),
        (p.write(1, 41, b"\x65"), (1, 101, 0, 100, "acceleration")),
        (p.write(1, 60, word(-10)), (1, -10, -9, 9, "soft goal")),
        (p.write(1, 60, word(10)), (1, 10, -9, 9, "soft goal")),
        (p.write(1, 31, TABLE["offset"].encode(-2047) + b"\1"), (1, 33, 0, 255, "EEPROM address")),
        (p.write(3, 5, b"\4"), (3, 5, 0, 255, "EEPROM address")),
        (p.write(1, 44, b"\0"), (1, 44, 0, 255, "read-only address")),
        (p.write(1, 42, word(1) + b"\0"), (1, 44, 0, 255, "read-only address")),
        (p.write(1, 45, b"\0"), (1, 45, 0, 255, "read-only address")),
        (p.write(1, 43, b"\0"), (1, 43, 0, 255, "read-only address")),
        (p.write(1, 41, b"\0\1"), (1, 42, 0, 255, "read-only address")),
        (p.write(2, 42, word(8)), (2, 2, 1, 3, "address to id")),
        (p.write(p.BROADCAST, 40, b"\1"), (254, 254, 1, 3, "address to id")),
        (p.instruction(2, REBOOT), (2, 2, 1, 3, "address to id")),
    ],
    ids=lambda each: each.hex() if isinstance(each, bytes) else str(each[-1]),
)
def test_what_is_refused_is_named_with_its_bounds(
    data: bytes, expected: tuple[int, float, float, float, str]
) -> None:
    assert refused(data) == expected
    assert refused(OFF + data) == expected


@pytest.mark.parametrize(
    "data",
    [
        p.instruction(1, REBOOT, b"\x29"),
        p.instruction(1, 0x06),
        p.instruction(1, p.WRITE),
        p.instruction(1, p.REG_WRITE, b"\x2a\0\0"),
        p.instruction(1, p.ACTION),
        p.instruction(p.BROADCAST, p.SYNC_WRITE),
        p.instruction(p.BROADCAST, p.SYNC_WRITE, b"\x29"),
        p.instruction(p.BROADCAST, p.SYNC_WRITE, b"\x29\2\1"),
        p.instruction(p.BROADCAST, p.SYNC_WRITE, b"\x29\2\1\0"),
        p.instruction(p.BROADCAST, p.SYNC_WRITE, b"\x29\1\1\0\3"),
    ],
    ids=lambda data: data.hex(),
)
def test_a_packet_that_is_no_write_as_the_writer_makes_it_is_not_sent(data: bytes) -> None:
    assert refused(data) == (p.BROADCAST, p.BROADCAST, 1, 3, "address to id")


def test_a_kept_register_may_be_written_on_the_unlocked_servo_alone() -> None:
    judge = check()
    judge.unlocked = 1
    judge.judge(p.write(1, 33, b"\5"))
    assert refused(p.write(3, 33, b"\5"), judge) == (3, 33, 0, 255, "EEPROM address")
    assert refused(p.write(1, 33, b"\0"), judge) == (1, 0, 1, 5, "limit")
    judge.unlocked = None
    assert refused(p.write(1, 33, b"\5"), judge) == (1, 33, 0, 255, "EEPROM address")
