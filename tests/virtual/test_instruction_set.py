"""The rarer instructions as a host sees them, each by its chapter of the e-manual page "Protocol 2.0"."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import examples
from tests.support.virtual_serial_host import Host
from twind_drivers.dynamixel import packet
from twind_drivers.dynamixel.packet import BROADCAST, Instruction

TURNS = bytes.fromhex("01 44 58 4C 22")
TAIL = bytes.fromhex("43 54 52 4C")
BOOTED = 0.15  # s, a reboot and some


def order(host: Host, id: int, code: int, params: bytes = b"") -> int | None:
    """The error byte of the answer; None: nobody answers."""
    answers = host.ask(packet.instruction(id, code, params))
    assert len(answers) <= 1
    return answers[0].error if answers else None


def back_up(host: Host, id: int, what: int) -> int | None:
    return order(host, id, Instruction.BACKUP, bytes((what,)) + TAIL)


# ---------------------------------------------------------------------- factory reset


@pytest.mark.parametrize(
    ("option", "id", "baud"),
    [(0xFF, 1, 1), (0x01, 7, 1), (0x02, 7, 4)],
)
def test_a_factory_reset_keeps_what_its_option_names(option: int, id: int, baud: int) -> None:
    """E-manual "Factory Reset": FF all, 01 all but the id, 02 all but id and baud rate."""
    host = Host([7], settings={"operating_mode": 4, "homing_offset": 300})
    host.write(7, 84, 1600, 2)
    (answer,) = host.ask(packet.instruction(7, Instruction.FACTORY_RESET, bytes((option,))))
    assert (answer.id, answer.error) == (7, 0)
    assert host.ask(packet.ping(7)) == [], "it reboots"
    host.wait(BOOTED)
    host.bus.line((57_600, 2_000_000)[baud == 4])
    host.raw(packet.write(id, 9, b"\0"))
    assert [host.read(id, *at) for at in ((7, 1), (8, 1), (11, 1), (20, 4))] == [id, baud, 3, 0]
    assert host.read(id, 84, 2) == 800
    assert [host.read(id, *at) for at in ((0, 2), (6, 1))] == [1020, 47], "it stays what it is"


def test_reset_all_to_every_id_at_once_is_ignored_from_firmware_42() -> None:
    """E-manual "Factory Reset": MX(2.0) and X from firmware 42."""
    for firmware, ids in ((41, {1}), (42, {3, 4})):
        host = Host([3, 4], firmware=firmware)
        assert order(host, BROADCAST, Instruction.FACTORY_RESET, b"\xff") is None
        host.wait(BOOTED)
        assert set(host.servos.registers.ids()) == ids
    assert order(host, BROADCAST, Instruction.FACTORY_RESET, b"\x02") is None
    host.wait(0.01)
    assert host.ask(packet.ping(3)) == [], "with another option all of them reset"


@pytest.mark.parametrize(("params", "error"), [(b"", 5), (b"\x03", 4)])
def test_a_factory_reset_without_a_known_option_does_nothing(params: bytes, error: int) -> None:
    host = Host([3], settings={"homing_offset": 9})
    assert order(host, 3, Instruction.FACTORY_RESET, params) == error
    assert host.read(3, 20, 4) == 9


# ---------------------------------------------------------------------- clear


@given(st.integers(-20_000, 20_000))
@examples(40)
def test_clear_leaves_one_turn(turned: int) -> None:
    """E-manual "Clear": the present position becomes what it is within one turn."""
    host = Host([1], settings={"operating_mode": 4}, start=0.0)
    host.muscles.position[0] = turned
    host.wait(0.01)
    assert host.present(1) == turned
    assert order(host, 1, Instruction.CLEAR, TURNS) == 0
    assert host.present(1) == turned % 4096


def test_clear_is_refused_while_it_moves_and_unknown_before_firmware_42() -> None:
    """E-manual "Clear": Result Fail while in motion; of X and MX(2.0) from firmware 42."""
    host = Host([1], settings={"operating_mode": 4})
    host.torque(1)
    host.goal(1, 9000)
    host.wait(0.1)
    assert order(host, 1, Instruction.CLEAR, TURNS) == 1
    host.wait(5.0)
    assert order(host, 1, Instruction.CLEAR, TURNS) == 0
    assert host.present(1) == pytest.approx(9000 - 2 * 4096, abs=2)
    assert order(Host([1], firmware=41), 1, Instruction.CLEAR, TURNS) == 2
    assert order(Host([1], model="PH54-100-S500"), 1, Instruction.CLEAR, TURNS) == 2


@pytest.mark.parametrize(("params", "error"), [(TURNS[:4], 5), (b"\x02" + TURNS[1:], 4), (b"\x01" * 5, 4)])
def test_clear_requires_its_fixed_bytes(params: bytes, error: int) -> None:
    host = Host([1], settings={"operating_mode": 4})
    host.muscles.position[0] = 9000.0
    host.wait(0.01)
    assert order(host, 1, Instruction.CLEAR, params) == error
    assert host.present(1) == 9000


# ---------------------------------------------------------------------- backup


def test_a_backup_is_stored_reported_and_restored_by_a_reboot() -> None:
    """E-manual "Control Table Backup": 01 store, 02 restore and reboot; register 147: there is one."""
    host = Host([1])
    host.write(1, 20, 500, 4)
    assert host.read(1, 147, 1) == 0
    assert back_up(host, 1, 2) == 1, "there is none yet"
    assert back_up(host, 1, 1) == 0
    assert host.read(1, 147, 1) == 1
    host.write(1, 20, 77, 4)
    assert back_up(host, 1, 2) == 0
    assert host.ask(packet.ping(1)) == []
    host.wait(BOOTED)
    assert (host.read(1, 20, 4), host.read(1, 147, 1)) == (500, 1)


def test_a_backup_needs_torque_off_and_the_firmware_for_it() -> None:
    """E-manual "Control Table Backup": error 1 while torque is on; X430 from 45, X330 from 46, P from 12."""
    host = Host([1])
    host.torque(1)
    assert (back_up(host, 1, 1), back_up(host, 1, 2)) == (1, 1)
    for model, first in (("XM430-W350", 45), ("XL330-M288", 46), ("PH54-100-S500", 12)):
        assert back_up(Host([1], model=model, firmware=first), 1, 1) == 0
        assert back_up(Host([1], model=model, firmware=first - 1), 1, 1) == 2


@pytest.mark.parametrize(
    ("params", "error"), [(b"", 5), (b"\x01", 5), (b"\x03" + TAIL, 4), (b"\x01" + TAIL[::-1], 4)]
)
def test_a_backup_requires_its_fixed_bytes(params: bytes, error: int) -> None:
    host = Host([1])
    assert order(host, 1, Instruction.BACKUP, params) == error
    assert host.read(1, 147, 1) == 0


# ---------------------------------------------------------------------- reg write and action


@pytest.mark.parametrize(
    ("params", "error"), [("7400 C800", 5), ("8400 C8000000", 7), ("6800 FF000000", 6), ("", 5)]
)
def test_a_reg_write_that_would_be_refused_is_refused_at_once(params: str, error: int) -> None:
    host = Host([1])
    assert order(host, 1, Instruction.REG_WRITE, bytes.fromhex(params)) == error
    assert host.read(1, 69, 1) == 0
    assert order(host, 1, Instruction.ACTION) == 2


def test_a_broadcast_action_executes_every_stored_write() -> None:
    """E-manual "Action": to every id at once, unanswered; who has stored nothing does nothing."""
    host = Host([1, 2, 3])
    for id, goal in ((1, 1000), (3, 3000)):
        params = (116).to_bytes(2, "little") + goal.to_bytes(4, "little")
        assert order(host, id, Instruction.REG_WRITE, params) == 0
    assert order(host, BROADCAST, Instruction.ACTION) is None
    assert host.servos["goal_position"].tolist() == [1000, 2048, 3000]
    assert host.servos["registered_instruction"].tolist() == [0, 0, 0]


def test_a_stored_write_is_judged_again_when_it_is_carried_out() -> None:
    host = Host([1])
    assert order(host, 1, Instruction.REG_WRITE, b"\x09\x00\x0a") == 0
    host.torque(1)
    assert order(host, 1, Instruction.ACTION) == 7, "EEPROM is locked by now"
    assert host.read(1, 9, 1) == 0


def test_a_requested_or_unrequested_reboot_clears_a_stored_write() -> None:
    host = Host([1])
    for reboot in (lambda: host.ask(packet.reboot(1)), lambda: host.bus.faults.brown_out(1)):
        order(host, 1, Instruction.REG_WRITE, bytes.fromhex("7400 C8000000"))
        reboot()
        host.wait(BOOTED)
        assert (host.read(1, 69, 1), order(host, 1, Instruction.ACTION)) == (0, 2)


# ---------------------------------------------------------------------- who answers


@pytest.mark.parametrize(
    ("code", "params"),
    [
        (Instruction.READ, bytes.fromhex("84000400")),
        (Instruction.WRITE, bytes.fromhex("410001")),
        (Instruction.REG_WRITE, bytes.fromhex("410001")),
        (Instruction.ACTION, b""),
        (Instruction.FACTORY_RESET, b"\x02"),
        (Instruction.REBOOT, b""),
        (Instruction.CLEAR, TURNS),
        (Instruction.BACKUP, b"\x01" + TAIL),
    ],
)
def test_only_a_ping_to_all_is_answered_and_levels_rule_the_rest(code: int, params: bytes) -> None:
    """E-manual "Packet ID" note, and Status Return Level (68): 0 ping only, 1 ping and read, 2 all."""
    assert order(Host([1]), BROADCAST, code, params) is None
    for level in (0, 1, 2):
        host = Host([1])
        host.raw(packet.write(1, 68, bytes((level,))))
        assert (order(host, 1, code, params) is not None) == (level >= (1 if code == Instruction.READ else 2))


def test_a_ping_to_all_is_answered_in_the_order_of_ids() -> None:
    host = Host([9, 2, 252, 0])
    assert [each.id for each in host.ask(packet.ping(BROADCAST))] == [0, 2, 9, 252]


def test_a_servo_with_a_new_id_acknowledges_under_the_old_id() -> None:
    """The SDK waits for the id that it asked; people change ids with it."""
    host = Host([1])
    (answer,) = host.ask(packet.write(1, 7, b"\x05"))
    assert (answer.id, answer.error) == (1, 0)
    (answer,) = host.ask(packet.ping(5))
    assert answer.id == 5


# ---------------------------------------------------------------------- shadow ids


def test_the_vendors_example_of_shadow_ids() -> None:
    """e-manual, "Secondary(Shadow) ID": five servos, first all with shadow id 5, then all with 100."""
    host = Host([1, 2, 3, 4, 5])

    def leds() -> list[int]:
        return host.servos.memory.raw[:, 65].tolist()

    for id in range(1, 6):
        assert host.write(id, 12, 5, 1) == 0
    assert [each.id for each in host.ask(packet.write(1, 65, b"\x01"))] == [1]
    assert leds() == [1, 0, 0, 0, 0]
    assert [each.id for each in host.ask(packet.write(5, 65, b"\x01"))] == [5]
    assert leds() == [1, 1, 1, 1, 1]
    for id in range(1, 6):
        host.write(id, 12, 100, 1)
    assert host.raw(packet.write(100, 65, b"\x00")) == b""
    assert leds() == [0, 0, 0, 0, 0]


def test_by_its_shadow_id_a_servo_never_answers_and_keeps_its_eeprom() -> None:
    """e-manual, "Secondary(Shadow) ID": RAM only, no status; 253..255 switch it off."""
    host = Host([1, 2], settings={"secondary_shadow_id": 50})
    eeprom = host.servos.memory.raw[:, :64].copy()
    for request in (
        packet.ping(50),
        packet.read(50, 132, 4),
        packet.sync_read([50], 132, 4),
        packet.fast_sync_read([50], 132, 4),
        packet.write(50, 20, bytes(4)),
        packet.write(50, 63, b"\x01\x01"),
        packet.instruction(50, Instruction.FACTORY_RESET, b"\x01"),
        packet.instruction(50, Instruction.BACKUP, b"\x01" + TAIL),
    ):
        assert host.raw(request) == b""
    assert (host.servos.memory.raw[:, :64] == eeprom).all()
    assert host.servos.memory.raw[:, 64].tolist() == [0, 0], "all or nothing"
    host.raw(packet.write(50, 64, b"\x01"))
    assert host.servos.memory.raw[:, 64].tolist() == [1, 1]
    host.raw(packet.reboot(50))
    assert host.ask(packet.ping(1)) == host.ask(packet.ping(2)) == []
    for off in (253, 254, 255):
        assert Host([1], settings={"secondary_shadow_id": off}).ask(packet.ping(1)) != []


def test_goals_by_sync_write_reach_shadows_too() -> None:
    host = Host([1, 2, 3], settings={"secondary_shadow_id": 60})
    for goal in (2100, 2200):
        host.raw(packet.sync_write(116, {60: goal.to_bytes(4, "little")}))
        assert host.servos["goal_position"].tolist() == [goal] * 3
    host.raw(packet.sync_write(116, {1: (1500).to_bytes(4, "little"), 60: (2300).to_bytes(4, "little")}))
    assert host.servos["goal_position"].tolist() == [2300] * 3, "row by row"


def test_a_servo_set_to_another_protocol_does_not_answer_this_one() -> None:
    """e-manual, "Protocol Type (13)"; Protocol 1.0 itself is not simulated."""
    host = Host([1, 2])
    assert host.write(1, 13, 1, 1) == 0
    assert [each.id for each in host.ask(packet.ping(BROADCAST))] == [2]


@given(code=st.integers(0, 255), params=st.binary(max_size=12), id=st.sampled_from([1, 2, 50, BROADCAST]))
@examples(120)
def test_no_instruction_and_no_parameters_break_the_bus(code: int, params: bytes, id: int) -> None:
    host = Host([1, 2], settings={"secondary_shadow_id": 50})
    host.raw(packet.instruction(id, code, params))
    host.wait(BOOTED)
    host.bus.line(2_000_000 if (host.servos["baud_rate"] == 4).any() else 57_600)
    assert host.ask(packet.ping(BROADCAST)) or (host.servos["protocol_type"] != 2).any()
    assert np.isfinite(host.muscles.position).all()
