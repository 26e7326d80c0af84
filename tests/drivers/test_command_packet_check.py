"""The last check of a command's bytes (WIRE_CLAMP): whole packets, known ids, writable addresses, goals."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import examples
from twind_drivers.bus import WireRangeError
from twind_drivers.dynamixel import packet as p
from twind_drivers.dynamixel.command_packet_check import CommandPacketCheck
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
