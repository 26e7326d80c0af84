"""Registers, codes and error bits of Feetech servos and of Protocol 1.0, as their makers print them."""

import pytest

from twind_drivers.dynamixel1 import dynamixel1_packet, dynamixel1_registers
from twind_drivers.dynamixel1.dynamixel1_models import model
from twind_drivers.dynamixel1.dynamixel1_registers import (
    BLOCKS,
    CURRENT_MODE,
    baud_of,
    registers_of,
    table_of,
)
from twind_drivers.feetech import feetech_packet
from twind_drivers.feetech.feetech_packet import FeetechInstruction
from twind_drivers.feetech.feetech_registers import (
    BAUDS,
    GOAL,
    IDENTITY,
    STATE_SIZE,
    map_of_firmware,
    register_map,
)


@pytest.mark.parametrize(
    ("firmware", "name"),
    [
        ((0, 0, 1), "scs"),
        ((0, 39, 1), "scs"),
        ((0, 40, 1), "unknown"),
        ((0, 0, 0), "unknown"),
        ((1, 0, 0), "smcl"),
        ((1, 39, 0), "smcl"),
        ((1, 40, 0), "unknown"),
        ((1, 0, 1), "unknown"),
        ((2, 39, 0), "unknown"),
        ((2, 40, 0), "smbl"),
        ((2, 69, 0), "smbl"),
        ((2, 70, 0), "unknown"),
        ((3, 0, 0), "sts"),
        ((3, 39, 0), "sts"),
        ((3, 40, 0), "hls"),
        ((3, 59, 0), "hls"),
        ((3, 60, 0), "unknown"),
        ((3, 19, 1), "unknown"),
        ((3, 20, 1), "scs2"),
        ((3, 39, 1), "scs2"),
        ((3, 40, 1), "unknown"),
        ((4, 20, 1), "unknown"),
    ],
)
def test_the_firmware_of_a_feetech_servo_says_which_registers_it_has(
    firmware: tuple[int, int, int], name: str
) -> None:
    assert map_of_firmware(*firmware).name == name


@pytest.mark.parametrize(
    ("name", "big_endian", "sync_read", "driven", "turn"),
    [
        ("sts", False, True, True, 4096.0),
        ("smbl", False, True, True, 4096.0),
        ("hls", False, True, True, 4096.0),
        ("scs", True, False, True, 1228.8),
        ("scs2", True, False, False, 1228.8),
        ("smcl", False, False, False, 4096.0),
        ("unknown", False, False, False, 4096.0),
    ],
)
def test_each_kind_of_feetech_servo_has_its_byte_order_and_turn(
    name: str, big_endian: bool, sync_read: bool, driven: bool, turn: float
) -> None:
    own = register_map(name)
    assert (own.big_endian, own.sync_read, own.driven, own.turn) == (big_endian, sync_read, driven, turn)


def test_an_hls_has_a_torque_where_others_have_a_time_and_no_overload_torque() -> None:
    hls, sts = register_map("hls"), register_map("sts")
    assert hls["goal_torque"].address == sts["goal_time"].address == 44
    assert set(sts) - set(hls) == {"goal_time", "overload_torque", "return_delay_time"}


def test_an_scs_has_neither_offset_nor_modes() -> None:
    missing = {"homing_offset", "operating_mode", "torque_limit", "acceleration", "present_current"}
    assert missing & set(register_map("scs")) == set()
    assert register_map("scs")["lock"].address == 48


def test_registers_of_feetech_servos_survive_power_off_below_40() -> None:
    sts = register_map("sts")
    assert sts["over_current_time"].address == 38 and sts["over_current_time"].kept
    assert (
        register_map("scs")["overload_torque"].address == 39 and register_map("scs")["overload_torque"].kept
    )
    assert sts["torque_enable"].address == 40 and not sts["torque_enable"].kept


def test_blocks_of_feetech_registers_end_where_their_last_register_ends() -> None:
    sts = register_map("sts")
    goal = sts["goal_position"]
    assert (goal.address, goal.size) == GOAL
    assert (sts["firmware_major"].address, sts["model_number"].end) == IDENTITY
    assert sts["torque_enable"].address + STATE_SIZE == sts["present_current"].end


def test_the_rates_of_register_6_are_in_the_order_of_its_codes() -> None:
    assert BAUDS == (1_000_000, 500_000, 250_000, 128_000, 115_200, 76_800, 57_600, 38_400)


def test_feetech_instructions_have_their_codes() -> None:
    assert {each.name: each.value for each in FeetechInstruction} == {
        "PING": 1,
        "READ": 2,
        "WRITE": 3,
        "REG_WRITE": 4,
        "ACTION": 5,
        "RECOVERY": 6,
        "REBOOT": 8,
        "CLEAR_TURNS": 10,
        "CALIBRATE": 11,
        "SYNC_READ": 0x82,
        "SYNC_WRITE": 0x83,
    }


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (0, "no error"),
        (0x01, "supply voltage"),
        (0x02, "encoder"),
        (0x04, "temperature"),
        (0x08, "current"),
        (0x20, "overload"),
        (0x24, "temperature, overload"),
        (0x10, "no error"),
    ],
)
def test_each_error_bit_of_a_feetech_servo_has_its_words(error: int, words: str) -> None:
    assert feetech_packet.explain(error) == words
    assert bool(error & feetech_packet.FAULT_BITS) == (words != "no error")


# ------------------------------------------------------------------------------- Protocol 1.0


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (0, "no error"),
        (0x01, "supply voltage"),
        (0x02, "goal outside its angle limits"),
        (0x04, "overheating"),
        (0x08, "value or address out of range"),
        (0x10, "checksum of the request"),
        (0x20, "overload"),
        (0x40, "unknown instruction"),
        (0x80, "shut down by an alarm (torque limit 34 is 0)"),
        (0x21, "supply voltage, overload"),
    ],
)
def test_each_error_bit_of_protocol_1_has_its_words(error: int, words: str) -> None:
    assert dynamixel1_packet.explain(error) == words


def test_the_state_of_a_servo_of_protocol_1_is_three_bits_of_its_errors() -> None:
    assert dynamixel1_packet.FAULT_BITS == 0x25
    assert dynamixel1_packet.RESET == 6


@pytest.mark.parametrize(
    ("code", "rate"),
    [
        (0, 2_000_000),
        (1, 1_000_000),
        (3, 500_000),
        (4, 400_000),
        (7, 250_000),
        (9, 200_000),
        (16, 115_200),
        (34, 57_600),
        (103, 19_200),
        (207, 9_600),
        (250, 2_250_000),
        (251, 2_500_000),
        (252, 3_000_000),
    ],
)
def test_register_4_stands_for_a_rate_that_ports_have(code: int, rate: int) -> None:
    """E-manual, "Baud Rate (4)": 2000000 / (code + 1), or the rate that is meant by it."""
    assert baud_of(code) == rate


@pytest.mark.parametrize(
    ("name", "table", "has", "has_not"),
    [
        ("AX-12A", "ax", "cw_compliance_slope", "drive_mode"),
        ("EX-106", "ex", "drive_mode", "position_p_gain"),
        ("MX-28(1.0)", "mx", "position_p_gain", "torque_control_mode"),
        ("MX-64(1.0)", "mx_current", "torque_control_mode", "drive_mode"),
        ("MX-106(1.0)", "mx_106", "drive_mode", "cw_compliance_slope"),
        (None, "unknown", "model_number", "torque_enable"),
    ],
)
def test_each_model_of_protocol_1_has_the_registers_of_its_page(
    name: str | None, table: str, has: str, has_not: str
) -> None:
    own = table_of(None if name is None else model(name))
    assert own is registers_of(table)
    assert has in own and has_not not in own


def test_blocks_of_protocol_1_are_its_eeprom_and_what_every_model_has_of_the_rest() -> None:
    own = registers_of("mx_current")
    assert ((0, 24), (24, own["punch"].end - 24)) == BLOCKS
    goal = own["goal_position"]
    assert (goal.address, goal.size) == (30, 2) == dynamixel1_registers.GOAL
    assert own["torque_enable"].address == 24 and not own["torque_enable"].kept
    assert own["resolution_divider"].address == 22 and own["resolution_divider"].kept
    mode = own["torque_control_mode"]
    assert (mode.address, mode.size) == CURRENT_MODE
