"""Errors that a write is answered with: e-manual "Protocol 2.0", Error, and the pages of the registers."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import examples
from tests.support.virtual_serial_host import Host
from twind_drivers.dynamixel import packet
from twind_drivers.dynamixel.control_tables import models, number_of, table

DRIVEN = [name for name in models() if not table(number_of(name), 60).facts.undriven]


# ---------------------------------------------------------------------- limit registers


@pytest.mark.parametrize("mode", [0, 1, 3, 4, 5, 16])
@pytest.mark.parametrize(
    ("limit", "size", "goal", "goal_size"),
    [(36, 2, 100, 2), (38, 2, 102, 2), (44, 4, 104, 4)],
    ids=["pwm", "current", "velocity"],
)
def test_a_goal_ends_at_its_limit_register_in_every_mode(
    mode: int, limit: int, size: int, goal: int, goal_size: int
) -> None:
    """e-manual, "Goal PWM (100)", "Goal Current (102)", "Goal Velocity (104)": error 6 beyond 36, 38, 44."""
    host = Host([1], settings={"operating_mode": mode})
    assert host.write(1, limit, 100, size) == 0
    assert [host.write(1, goal, value, goal_size) for value in (100, -100)] == [0, 0]
    assert [host.write(1, goal, value, goal_size) for value in (101, -101)] == [6, 6]
    assert host.read(1, goal, goal_size) == -100


@pytest.mark.parametrize("mode", [0, 1, 3, 4, 5, 16])
def test_position_limits_count_in_mode_3_alone(mode: int) -> None:
    """e-manual, "Min/Max Position Limit (48, 52)"."""
    host = Host(
        [1], settings={"operating_mode": mode, "min_position_limit": 1000, "max_position_limit": 3000}
    )
    inside, beyond = (host.goal(1, goal) for goal in (3000, 3001))
    assert (inside, beyond) == (0, 6 if mode == 3 else 0)
    assert host.goal(1, 1_048_576) == 4, "more than 256 turns, in any mode"


def test_all_or_nothing_over_several_registers() -> None:
    """One packet over profile acceleration, profile velocity and goal position (108..119)."""
    host = Host([1])
    good, bad = (
        (5).to_bytes(4, "little") + (6).to_bytes(4, "little") + at for at in (bytes(4), b"\0\x20\0\0")
    )
    (answer,) = host.ask(packet.write(1, 108, bad))
    assert (answer.error, host.read(1, 108, 4), host.read(1, 112, 4)) == (6, 0, 0)
    (answer,) = host.ask(packet.write(1, 108, good))
    assert (answer.error, host.read(1, 108, 4), host.read(1, 116, 4)) == (0, 5, 0)


# ---------------------------------------------------------------------- drive mode


@pytest.mark.parametrize(
    ("model", "firmware", "bits"),
    [
        ("XM430-W350", 41, 0b0001),
        ("XM430-W350", 44, 0b0101),
        ("XM430-W350", 45, 0b1101),
        ("XL330-M288", 45, 0b0101),
        ("XL330-M288", 46, 0b1101),
        ("XM540-W270", 45, 0b1111),
        ("XW540-T260", 45, 0b1101),
        ("MX-106", 45, 0b0111),
        ("MX-28", 45, 0b0101),
    ],
)
def test_a_servo_takes_the_drive_mode_bits_that_it_has(model: str, firmware: int, bits: int) -> None:
    """e-manual, "Drive Mode (10)": slave on the 540 and MX-106, time-based profile from 42, torque on by goal
    from 45 (X330: 46) and on no MX; the other bits are always 0."""
    host = Host([1], model=model, firmware=firmware)
    assert {value for value in range(16) if host.write(1, 10, value, 1) == 0} == {
        value for value in range(16) if not value & ~bits
    }
    assert host.write(1, 10, 16, 1) == 4


@pytest.mark.parametrize(
    ("mode", "address", "size"),
    [(0, 102, 2), (1, 104, 4), (3, 116, 4), (4, 116, 4), (5, 116, 4), (16, 100, 2)],
)
def test_bit_3_lets_the_goal_of_the_mode_switch_torque_on_and_no_other(
    mode: int, address: int, size: int
) -> None:
    """e-manual, "Drive Mode": Torque On by Goal Update."""
    host = Host([1], settings={"drive_mode": 8, "operating_mode": mode})
    for other, width in ((100, 2), (102, 2), (104, 4), (116, 4)):
        if other != address:
            assert host.write(1, other, 10, width) == 0
    assert host.read(1, 64, 1) == 0
    assert host.write(1, address, 10, size) == 0
    assert host.read(1, 64, 1) == 1
    assert host.read(1, address, size) == 10


@pytest.mark.parametrize("mode", [0, 1, 3, 4, 5, 16])
def test_bit_3_switches_torque_on_by_the_goal_of_the_mode_also_by_sync_write(mode: int) -> None:
    host = Host([1], settings={"drive_mode": 8, "operating_mode": mode})
    for goal in (2100, 2200):  # the first and the remembered one
        host.raw(packet.sync_write(116, {1: goal.to_bytes(4, "little")}))
        assert host.read(1, 64, 1) == (mode in (3, 4, 5))
        assert host.read(1, 116, 4) == goal


# ---------------------------------------------------------------------- firmware


def test_the_bus_watchdog_comes_with_firmware_38() -> None:
    """e-manual, "Bus Watchdog (98)"; before it, register 98 is undefined."""
    assert Host([1], firmware=38).write(1, 98, 5, 1) == 0
    host = Host([1], firmware=37)
    assert host.write(1, 98, 5, 1) == 7
    host.torque(1)
    host.wait(5.0)
    assert not host.servos.tripped[0]


def test_startup_configuration_and_backup_ready_come_with_firmware_45() -> None:
    """e-manual, "Startup Configuration (60)", "Backup Ready (147)"; X330: 46."""
    for model, first in (("XM430-W350", 45), ("XL330-M288", 46)):
        assert Host([1], model=model, firmware=first).write(1, 60, 1, 1) == 0
        old = Host([1], model=model, firmware=first - 1)
        assert old.write(1, 60, 1, 1) == 7
        (answer,) = old.ask(packet.read(1, 147, 1))
        assert answer.error == 7


# ---------------------------------------------------------------------- models


@pytest.mark.parametrize("model", DRIVEN)
def test_every_model_that_can_be_driven_can_be_virtual(model: str) -> None:
    """By its own table: torque, a goal, the watchdog with its trip and its end, and the reading."""
    registers = table(number_of(model), 60)
    host = Host([1], model=model, firmware=60)

    def at(key: str) -> tuple[int, int]:
        return registers[key].address, registers[key].size

    def write(key: str, value: int) -> int:
        address, size = at(key)
        return host.write(1, address, value, size)

    assert host.read(1, *at("model_number"), signed=False) == number_of(model)
    if 3 in registers.facts.modes:
        assert write("operating_mode", 3) == 0
    goal = host.read(1, *at("present_position")) + 50
    if "rh_p12" in registers.stem:  # the gripper: its stroke ends at 740, and it has no position mode
        goal = 500
    assert write("torque_enable", 1) == 0
    assert write("id", 5) == 7, "EEPROM is locked"
    if registers.facts.caps_current:  # of a Y: from the start 0, which lets nothing through
        assert [write("goal_pwm", 1000), write("goal_current", 2080)] == [0, 0]
    assert write("goal_position", goal) == 0
    host.wait(3.0)
    if 3 in registers.facts.modes:
        assert host.read(1, *at("present_position")) == pytest.approx(goal, abs=2)
    assert write("present_position", 1) == 7
    assert write("bus_watchdog", 5) == 0
    host.wait(0.2)
    assert host.read(1, *at("bus_watchdog")) == -1
    assert write("goal_position", goal) & 0x7F == 4, "beside the alert of a Y"
    assert write("bus_watchdog", 0) == 0
    assert write("goal_position", goal) == 0


def test_an_x_a_small_x_and_a_p_on_one_bus_each_keep_their_own_rules() -> None:
    """Registers at other addresses: one trips, one reboots, one is shut down, the others do not notice."""
    host = Host([1, 2, 3, 4], model=["XM430-W350", "XL330-M288", "PH54-100-S500", "XL430-W250"], firmware=52)
    tables = host.servos.memory.tables
    for id, registers in enumerate(tables, start=1):
        assert host.write(id, registers["torque_enable"].address, 1, 1) == 0
    assert host.write(3, tables[2]["bus_watchdog"].address, 5, 1) == 0
    host.wait(0.2)
    assert host.servos.tripped.tolist() == [False, False, True, False]
    assert host.servos["bus_watchdog"].tolist() == [0, 0, 255, 0]
    host.ask(packet.reboot(2))
    host.bus.faults.damage(4, 32)
    host.wait(0.2)
    assert host.servos["torque_enable"].tolist() == [1, 0, 1, 0]
    assert host.servos["hardware_error_status"].tolist() == [0, 0, 0, 32]
    host.write(3, tables[2]["bus_watchdog"].address, 0, 1)
    for registers, id in zip(tables, (1, 2, 3, 4), strict=True):
        request = packet.sync_write(registers["goal_position"].address, {id: (2100).to_bytes(4, "little")})
        assert host.raw(request) == b""
    assert host.servos["goal_position"].tolist() == [2100] * 4


def test_a_model_of_another_layout_is_refused_with_a_reason() -> None:
    with pytest.raises(ValueError, match=r"XL320: not simulated: .*dynamixel2_unwatched"):
        Host([1], model="XL320")


@examples(100)
@given(
    st.sampled_from(["XM430-W350", "XL330-M288", "XL430-W250", "PH54-100-S500"]),
    st.one_of(st.integers(0, 900), st.integers(0, 150)),
    st.one_of(st.binary(max_size=8), st.integers(0, 3).map(lambda value: bytes((value,)))),
    st.booleans(),
)
def test_a_refused_write_changes_no_byte(model: str, address: int, data: bytes, torque: bool) -> None:
    """Anywhere in the table and behind it, with torque off and on (then the EEPROM is locked)."""
    host = Host([1], model=model)
    registers = host.servos.memory.tables[0]
    host.write(1, registers["torque_enable"].address, int(torque), 1)
    before = host.servos.memory.raw.copy()
    answers = host.ask(packet.write(1, address, data))
    locked = torque and data and address < registers["torque_enable"].address
    if locked:
        assert answers[0].error in (5, 7)
    if not answers:  # it has just been told not to answer writes
        assert address <= registers["status_return_level"].address < address + len(data)
    elif answers[0].error:
        assert (host.servos.memory.raw == before).all()
