"""The last check of a command's bytes (WIRE_CLAMP): whole packets, known ids, writable addresses, goals."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import examples
from twind_drivers.bus import WireRangeError
from twind_drivers.dynamixel import packet as p
from twind_drivers.dynamixel.command_packet_check import CommandPacketCheck, written_rows
from twind_drivers.dynamixel.control_tables import table
from twind_drivers.dynamixel.operating_modes import MODES, fences

XM430 = table(1020)
IDS = (1, 2)
CHECK = CommandPacketCheck(
    "bus", dict.fromkeys(IDS, XM430), {id: fences(XM430, MODES[3], 1000, 3000, None) for id in IDS}
)
GAIN = p.sync_write(84, {1: bytes(2), 2: bytes(2)})


def test_an_allowed_write_passes_the_wire_check() -> None:
    CHECK.judge(GAIN)
    CHECK.judge(p.write(1, 64, b"\1") + p.sync_write(116, {2: (3000).to_bytes(4, "little")}) + p.reboot(2))


@pytest.mark.parametrize(
    "data",
    [
        b"",
        GAIN[:-1],
        GAIN + b"\0",
        GAIN + GAIN[:-1],
        b"\0" + GAIN,
        GAIN[:-1] + bytes((GAIN[-1] ^ 1,)),
        p.instruction(1, p.Instruction.FACTORY_RESET, b"\x02"),
        p.instruction(1, p.Instruction.CLEAR, b"\x01\x44\x58\x4c\x22"),
        p.instruction(1, p.Instruction.BACKUP, b"\x02CTRL"),
        p.instruction(1, p.Instruction.REG_WRITE, b"\x74\x00" + (2000).to_bytes(4, "little")),
        p.instruction(p.BROADCAST, p.Instruction.BULK_WRITE, b"\x01\x40\x00\x01\x00\x01"),
        p.instruction(p.BROADCAST, p.Instruction.ACTION),
        p.instruction(p.BROADCAST, p.Instruction.WRITE, b"\x40\x00\x01"),
        p.instruction(p.BROADCAST, p.Instruction.REBOOT),
        p.sync_write(64, {1: b"\1", 3: b"\1"}),
        p.instruction(
            p.BROADCAST, p.Instruction.SYNC_WRITE, b"\x40\x00\x01\x00\x01\x01\x02"
        ),  # a row cut short
        p.instruction(p.BROADCAST, p.Instruction.SYNC_WRITE, b"\x40\x00\x00"),
    ],
)
def test_anything_else_is_not_sent(data: bytes) -> None:
    with pytest.raises(WireRangeError, match="packet not sent"):
        CHECK.judge(data)


@pytest.mark.parametrize("address", [*range(224, 252), *range(634, 662)])
def test_nothing_is_written_by_way_of_an_indirect_address(address: int) -> None:
    """Indirect data 1..56 of an X430 is whatever register it is mapped to, a goal or torque too."""
    with pytest.raises(WireRangeError, match="read-only address"):
        CHECK.judge(p.write(1, address, b"\1"))


def goal(value: int, size: int = 4) -> bytes:
    """A goal's bytes."""
    return value.to_bytes(size, "little", signed=True)


def refused(data: bytes, judge: CommandPacketCheck = CHECK) -> tuple[int, float, float, float, str]:
    """Id, value and bounds that the error names, and what it calls them."""
    with pytest.raises(WireRangeError) as error:
        judge.judge(data)
    found = error.value
    what = str(found).partition(f"id {found.id}: ")[2].partition(f" {found.value} outside")[0]
    return found.id, found.value, found.lower, found.upper, what


@pytest.mark.parametrize("data", [
    p.write(1, 116, goal(1000)), p.write(2, 116, goal(3000)), p.write(1, 112, bytes(4)),  # up to the goal
    p.write(1, 108, bytes(4)), p.write(1, 102, goal(1193, 2)),  # from the end of another goal on
    p.instruction(p.BROADCAST, p.Instruction.SYNC_WRITE, b"\x74\x00\x04\x00"),  # no rows
])  # fmt: skip
def test_a_goal_on_its_bound_and_a_register_beside_it_may_be_written(data: bytes) -> None:
    CHECK.judge(data)


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (b"", (p.BROADCAST, 0, 0, 0, "stray bytes in a packet")),
        (GAIN + b"\0", (p.BROADCAST, len(GAIN) + 1, 0, 0, "stray bytes in a packet")),
        (p.write(1, 116, goal(999)), (1, 999, 1000, 3000, "goal")),
        (p.write(2, 116, goal(3001)), (2, 3001, 1000, 3000, "goal")),
        (p.write(1, 116, goal(-1000)), (1, -1000, 1000, 3000, "goal")),
        (p.sync_write(116, {1: goal(2000), 2: goal(3001)}), (2, 3001, 1000, 3000, "goal")),
        (p.write(1, 116, goal(2000, 2)), (1, 2000, 1000, 3000, "goal")),
        (p.write(1, 112, bytes(4) + goal(2000)), (1, 2000 << 32, 1000, 3000, "goal")),
        (p.write(1, 119, b"\0"), (1, 0, 1000, 3000, "goal")),
        (p.write(1, 115, b"\1\0"), (1, 1, 1000, 3000, "goal")),
        (p.write(1, 104, goal(5)), (1, 5, 0, -1, "register 104, no goal of this mode:")),
        (p.write(1, 120, b"\0"), (1, 120, min(XM430.writable), max(XM430.writable), "read-only address")),
        (p.write(3, 64, b"\1"), (3, 3, 1, 2, "address to id")),
        (p.reboot(3), (3, 3, 1, 2, "address to id")),
    ],
    ids=lambda each: each.hex() if isinstance(each, bytes) else str(each[-1]),
)  # fmt: skip
def test_what_is_refused_is_named_with_its_bounds(
    data: bytes, expected: tuple[int, float, float, float, str]
) -> None:
    assert refused(data) == expected


def test_a_range_of_one_goal_permits_that_one() -> None:
    one = CommandPacketCheck("bus", {1: XM430}, {1: fences(XM430, MODES[3], 2000, 2000, None)})
    one.judge(p.write(1, 116, goal(2000)))
    assert refused(p.write(1, 116, goal(2001)), one) == (1, 2001, 2000, 2000, "goal")


@pytest.mark.parametrize(
    ("data", "rows"),
    [
        (p.write(7, 0x174, b"abc"), [(7, 0x174, b"abc")]),
        (p.sync_write(0x174, {7: b"ab", 9: b"cd"}), [(7, 0x174, b"ab"), (9, 0x174, b"cd")]),
        (p.reboot(7), [(7, 0, b"")]),
        (p.instruction(7, p.Instruction.REG_WRITE, b"\x74\1ab"), [(p.BROADCAST, 0x174, b"ab")]),
    ],
)
def test_the_writes_of_a_packet_are_listed_by_id(data: bytes, rows: list[tuple[int, int, bytes]]) -> None:
    [found] = p.Framer(status=False).feed(data)
    assert written_rows(found) == rows


def test_a_sync_write_of_long_rows_is_listed_whole() -> None:
    """Their size has two bytes."""
    [found] = p.Framer(status=False).feed(p.sync_write(64, {1: bytes(300), 2: bytes(300)}))
    assert written_rows(found) == [(1, 64, bytes(300)), (2, 64, bytes(300))]


@given(st.integers(0, 700), st.binary(min_size=1, max_size=12))
@examples(300)
def test_no_write_reaches_a_goal_register_but_a_goal_inside_its_fence(address: int, data: bytes) -> None:
    touched = set(range(address, address + len(data)))
    goals = set(range(102, 108)) | set(range(116, 120))  # goal current and velocity, goal position
    whole = {
        (102, 2): (0, 1193),  # goal current: a cap without effect in mode 3
        (116, 4): (1000, 3000),
    }
    word = int.from_bytes(data, "little", signed=True)
    low, high = whole.get((address, len(data)), (0, -1))
    allowed = touched <= XM430.writable and (not touched & goals or low <= word <= high)
    try:
        CHECK.judge(p.write(1, address, data))
    except WireRangeError:
        assert not allowed
    else:
        assert allowed
