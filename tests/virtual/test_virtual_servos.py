"""The firmware's rules, each by the document that states it: e-manual chapter or field report."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.examples import examples
from tests.support.virtual_serial_host import Host
from twind_drivers.dynamixel import packet

ALERT = 0x80


# ---------------------------------------------------------------------- errors


@pytest.mark.parametrize(
    ("address", "value", "size", "error", "why"),
    [
        (64, 2, 1, 4, "range: torque enable is 0 or 1"),
        (98, 128, 1, 4, "range: bus watchdog is 0..127"),
        (84, 16384, 2, 4, "range: gains end at 16383"),
        (116, 100, 2, 5, "length: goal position has 4 bytes"),
        (112, 7, 1, 5, "length: profile velocity has 4 bytes"),
        (116, 4096, 4, 6, "limit: max position limit"),
        (116, -1, 4, 6, "limit: min position limit"),
        (104, 201, 4, 6, "limit: velocity limit 200"),
        (102, -1194, 2, 4, "range: no XM430 has more than 1193"),
        (132, 5, 4, 7, "access: present position is read-only"),
        (0, 5, 2, 7, "access: model number is read-only"),
        (71, 5, 1, 7, "access: nothing is at 71"),
        (116, 2000, 4, 0, "fine"),
    ],
)
def test_a_write_is_answered_with_the_documented_error(
    address: int, value: int, size: int, error: int, why: str
) -> None:
    host = Host([1])
    before = host.servos.memory.raw.copy()
    assert host.write(1, address, value, size) == error, why
    if error:
        assert (host.servos.memory.raw[:, :120] == before[:, :120]).all(), "all or nothing"


def test_eeprom_is_locked_while_torque_is_on_and_open_after() -> None:
    """e-manual, "Control Table": EEPROM is writable only while Torque Enable is 0; error 7."""
    host = Host([1])
    host.torque(1)
    assert host.write(1, 9, 10, 1) == 7
    host.torque(1, False)
    assert host.write(1, 9, 10, 1) == 0
    assert host.read(1, 9, 1) == 10


@pytest.mark.parametrize(
    ("model", "modes"),
    [
        ("XM430-W350", {0, 1, 3, 4, 5, 16}),
        ("XL430-W250", {1, 3, 4, 16}),
        ("PH54-100-S500", {0, 1, 3, 4, 16}),
    ],
)
def test_the_modes_that_a_model_has_are_taken_and_no_others(model: str, modes: set[int]) -> None:
    """e-manual, "Operating Mode" of each model's page: without current sensing there is no mode 0 and 5."""
    host = Host([1], model=model)
    assert {mode for mode in range(20) if host.write(1, 11, mode, 1) == 0} == modes


def test_reading_nothing_or_past_the_end_is_an_access_error_and_gaps_read_zero() -> None:
    host = Host([1])
    for address, size in ((71, 4), (1000, 4), (650, 60)):
        (answer,) = host.ask(packet.read(1, address, size))
        assert (answer.error, answer.data) == (7, b"")
    (answer,) = host.ask(packet.read(1, 64, 35))
    assert len(answer.data) == 35
    assert answer.data[2] == 0


# ---------------------------------------------------------------------- goals and torque


def test_a_goal_without_torque_is_stored_and_moves_nothing() -> None:
    host = Host([1])
    assert host.goal(1, 3000) == 0
    host.wait(1.0)
    assert host.present(1) == 2048
    assert host.read(1, 116, 4) == 3000


def test_torque_on_resumes_the_old_goal_unless_switched() -> None:
    """reachy_mini #1136: a jump to the old goal; some notes say goal := present. Default: the harsher."""
    for keep, expected in ((True, 3000), (False, 2048)):
        host = Host([1], keep_goal=keep)
        host.goal(1, 3000)
        host.torque(1)
        host.wait(2.0)
        assert host.present(1) == pytest.approx(expected, abs=1)


def test_drive_mode_bit_3_lets_a_goal_switch_torque_on() -> None:
    """e-manual, "Drive Mode": Torque On by Goal Update, single writes and sync writes alike."""
    host = Host([1, 2], settings={"drive_mode": 8})
    host.goal(1, 2500)
    host.bus.receive(packet.sync_write(116, {2: (2600).to_bytes(4, "little")}), host.clock.now())
    host.wait(2.0)
    assert [host.read(id, 64, 1) for id in (1, 2)] == [1, 1]
    assert host.present(1) == pytest.approx(2500, abs=1)
    assert host.present(2) == pytest.approx(2600, abs=1)


def test_goal_pwm_zero_pulls_at_nothing() -> None:
    host = Host([1])
    host.write(1, 100, 0, 2)
    host.torque(1)
    host.goal(1, 3000)
    host.wait(1.0)
    assert host.present(1) == 2048


def test_reading_while_moving_shows_signed_velocity_and_moving() -> None:
    host = Host([1])
    host.torque(1)
    host.goal(1, 1000)
    host.wait(0.05)
    assert host.read(1, 128, 4) < -100
    assert host.read(1, 122, 1) == 1
    assert host.read(1, 123, 1) & 1 == 0
    host.wait(3.0)
    assert (host.read(1, 128, 4), host.read(1, 122, 1), host.read(1, 123, 1) & 1) == (0, 0, 1)


# ---------------------------------------------------------------------- frames


@examples(50)
@given(st.integers(-20_000, 20_000), st.integers(-1024, 1024), st.booleans())
def test_torque_on_in_mode_3_collapses_to_one_turn_plus_offset(
    start: int, offset: int, reverse: bool
) -> None:
    """e-manual, operating mode note; after it the servo reports h + ((present - h) mod 4096)."""
    host = Host(
        [1],
        settings={"homing_offset": offset, "drive_mode": int(reverse), "operating_mode": 4},
        start=float(start),
    )
    host.muscles.position[0] += 9000.0  # turned by hand
    host.wait(0.01)
    host.write(1, 11, 3, 1)
    present = host.present(1)
    host.muscles.position[0] += 5000.0
    host.wait(0.01)
    turned = host.present(1)
    assert turned - present == (-5000 if reverse else 5000), "continuous while torque is off"
    host.write(1, 100, 0, 2)  # no output, so that it stays there
    host.torque(1)
    assert host.present(1) == offset + (turned - offset) % 4096


def test_the_forum_case_of_a_present_of_3700_that_becomes_minus_396() -> None:
    """ROBOTIS forum 7814: XC430, mode 3, offset -512."""
    host = Host([1], settings={"homing_offset": -512}, start=0.0)
    host.muscles.position[0] = 4212.0
    host.wait(0.01)
    assert host.present(1) == 3700
    host.goal(1, 3700)
    host.torque(1)
    assert host.present(1) == pytest.approx(-396, abs=3)
    host.wait(5.0)
    assert (host.present(1), round(host.muscles.position[0])) == (3700, 4212 + 4096), "a full turn"


@pytest.mark.parametrize(("offset", "shown"), [(1024, 3072), (-1024, 1024), (1025, 2048), (-5000, 2048)])
def test_in_mode_3_an_offset_beyond_1024_is_silently_ignored(offset: int, shown: int) -> None:
    host = Host([1])
    assert host.write(1, 20, offset, 4) == 0
    assert host.read(1, 20, 4) == offset, "the register keeps it"
    assert host.present(1) == shown
    host.write(1, 11, 4, 1)
    assert host.present(1) == 2048 + offset, "live in the other modes"


def test_a_change_of_mode_resets_gains_profile_and_caps() -> None:
    """e-manual, "Operating Mode" note: PID and feedforward gains, profile, goal PWM and goal current."""
    host = Host([1], settings={"pwm_limit": 700})
    registers = ((84, 2), (82, 2), (80, 2), (90, 2), (88, 2), (112, 4), (108, 4), (100, 2), (102, 2))
    for address, size in registers:
        assert host.write(1, address, 30, size) == 0
    host.write(1, 11, 4, 1)
    assert [host.read(1, *at) for at in registers] == [800, 0, 0, 0, 0, 0, 0, 700, 1193]


def test_the_realtime_tick_wraps_at_32768_ms() -> None:
    host = Host([1])
    host.wait(32.760)
    assert host.read(1, 120, 2, signed=False) in (32760, 32761)
    host.wait(0.010)
    assert host.read(1, 120, 2, signed=False) < 10


# ---------------------------------------------------------------------- watchdog


def armed(ids: tuple[int, ...] = (1, 2), units: int = 5) -> Host:
    host = Host(ids)
    for id in ids:
        assert host.write(id, 98, units, 1) == 0
        host.torque(id)
    return host


@examples(30)
@given(st.integers(1, 127))
def test_the_watchdog_trips_exactly_its_units_times_20_ms_after_the_last_packet(units: int) -> None:
    """e-manual, Bus Watchdog (98): 20 ms a unit, any instruction packet feeds it."""
    host = armed((1,), units)
    fed = float(host.servos.heard_at[0])
    host.bus.advance(fed + units * 0.02 - 1e-6)
    assert not host.servos.tripped[0]
    host.bus.advance(fed + 5.0 + units * 0.02)  # told late, tripped on time
    assert host.servos.tripped_at[0] == pytest.approx(fed + units * 0.02, abs=1e-9)
    assert host.servos.trip_delay[0] == pytest.approx(units * 0.02)


def test_any_valid_packet_resets_every_watchdog_and_a_corrupt_one_none() -> None:
    host = armed()
    for _ in range(20):
        host.wait(0.09)
        host.raw(packet.ping(2))
    assert not host.servos.tripped.any()
    for _ in range(3):
        host.wait(0.04)
        host.raw(packet.ping(2)[:-1] + b"\x00")
    assert host.servos.tripped.all()


def test_the_watchdog_is_inactive_while_torque_is_off() -> None:
    host = armed()
    host.torque(1, False)
    host.wait(1.0)
    assert host.servos.tripped.tolist() == [False, True]


def test_a_tripped_servo_stops_keeps_torque_and_refuses_goals() -> None:
    """e-manual, Bus Watchdog: 98 reads -1, goals are read-only (error 4), torque stays on."""
    host = armed((1,))
    host.goal(1, 4000)
    host.wait(0.1001)
    assert host.servos.tripped[0]
    here = host.muscles.position[0]
    assert here < 3000, "still under way"
    host.wait(2.0)
    assert abs(host.muscles.position[0] - here) <= 64
    assert host.read(1, 98, 1) == -1
    assert host.read(1, 64, 1) == 1
    for address, size in ((100, 2), (102, 2), (104, 4), (116, 4)):
        assert host.write(1, address, 1, size) == 4
    host.raw(packet.sync_write(116, {1: (100).to_bytes(4, "little")}))
    assert host.read(1, 116, 4) == 4000
    assert host.write(1, 98, 5, 1) == 4, "only 0 clears"


def test_cleared_it_resumes_the_goal_register() -> None:
    host = armed((1,))
    host.goal(1, 3900)
    host.wait(0.2)
    assert host.write(1, 98, 0, 1) == 0
    host.wait(3.0)
    assert host.present(1) == pytest.approx(3900, abs=1)
    assert host.goal(1, 2000) == 0


def test_a_servo_at_rest_does_not_move_when_it_trips() -> None:
    host = armed((1,))
    host.goal(1, 2100)
    for _ in range(30):
        host.wait(0.05)
        host.raw(packet.ping(1))
    before = host.muscles.position[0]
    host.wait(1.0)
    assert host.servos.tripped[0]
    assert abs(host.muscles.position[0] - before) < 0.5


# ---------------------------------------------------------------------- faults and reboot


def test_a_reboot_answers_then_is_off_the_bus_then_has_its_defaults() -> None:
    host = Host([1, 2])
    host.write(1, 84, 1600, 2)
    host.write(1, 98, 5, 1)
    host.torque(1)
    (answer,) = host.ask(packet.reboot(1))
    assert (answer.id, answer.error) == (1, 0)
    host.wait(0.05)
    assert host.ask(packet.ping(1)) == []
    assert len(host.ask(packet.ping(2))) == 1
    host.wait(0.06)
    assert len(host.ask(packet.ping(1))) == 1
    assert [host.read(1, *at) for at in ((84, 2), (98, 1), (64, 1))] == [800, 0, 0]
    assert host.read(1, 9, 1) == 0, "EEPROM stays"
    assert host.read(1, 120, 2) < 100, "its clock begins anew"


# ---------------------------------------------------------------------- models


def test_models_have_their_own_tables_and_defaults() -> None:
    for model, number, p in (("XM430-W350", 1020, 800), ("XL330-M288", 1200, 400), ("XL430-W250", 1060, 640)):
        host = Host([1], model=model)
        assert host.read(1, 0, 2) == number
        assert host.read(1, 84, 2) == p
    assert host.write(1, 102, 5, 2) == 7, "an XL430 has no goal current"
    host.torque(1)
    host.goal(1, 2500)
    host.wait(1.0)
    assert host.present(1) == pytest.approx(2500, abs=1), "no current limit register is no limit"
