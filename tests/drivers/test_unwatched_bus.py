"""Reader and writer of XL-320 and PRO -R on the virtual bus: what differs from other drivers."""

import math

import numpy as np
import pytest

from tests.support.driver_rig import both
from tests.support.unwatched_rig import UnwatchedRig
from twind_drivers.bus import DeviceRefused, WireRangeError, WriteRequest
from twind_drivers.dynamixel.control_tables import table
from twind_drivers.dynamixel2_unwatched.unwatched_models import model, models
from twind_drivers.dynamixel2_unwatched.unwatched_registers import layout_of
from twind_drivers.dynamixel2_unwatched.unwatched_slow_registers import SHUT_DOWN

XL = ["XL-320"] * 3
PRO = ["H54-200-S500-R", "H42-20-S300-R", "L54-30-S400-R"]
BUSES = pytest.mark.parametrize("names", [XL, PRO], ids=["xl320", "pro_r"])
RENAMED = {
    "cw_angle_limit": "min_position_limit",
    "ccw_angle_limit": "max_position_limit",
    "d_gain": "position_d_gain",
    "i_gain": "position_i_gain",
    "p_gain": "position_p_gain",
    "present_speed": "present_velocity",
    "present_voltage": "present_input_voltage",
}


def test_the_table_of_an_xl320_has_the_addresses_of_the_vendors_file() -> None:
    vendors = {RENAMED.get(key, key): each for key, each in table(350).fields.items()}
    own = layout_of("xl320").table.registers
    assert {key: (each.address, each.size) for key, each in vendors.items()} == {
        key: (each.address, each.size) for key, each in own.items()
    }


@pytest.mark.parametrize(("name", "number"), [(name, each.number) for name, each in models().items()])
def test_every_pro_r_is_one_number_below_its_successor(name: str, number: int) -> None:
    """The vendor's index has the -RA of the H and M series alone."""
    if name.startswith(("H", "M")):
        assert table(number + 1).model == f"{name}A"
        assert model(name).figures.gear * (1000 if name[1:3] == "54" or name[0] == "H" else 1024) > 0


@BUSES
def test_servos_are_identified_armed_and_moved(names: list[str]) -> None:
    rig = UnwatchedRig(names)
    devices = rig.perform(rig.reader.identify())
    assert [each.model_name for each in devices] == names
    assert all(each.settings["homing_offset"] == 0 for each in devices)
    here = rig.arm()
    step = int(rig.stroke / 10)
    for cycle in range(40):
        rig.tick(here + step * cycle // 8)
    samples = rig.ticks(60, here + step * 5)
    assert abs(rig.places() - here - step * 5).max() <= 3 * rig.stroke / 100
    assert all(sample.heard.all() for sample in samples)
    assert rig.registers.torque.tolist() == [1, 1, 1]
    assert rig.registers.fault.tolist() == [0, 0, 0]
    assert np.isfinite(rig.registers.status_time).all()
    assert np.isfinite(rig.registers.voltage).all()


@BUSES
def test_it_holds_its_last_goal_when_the_master_is_gone(names: list[str]) -> None:
    """There is no watchdog: that is what the daemon must deal with."""
    rig = UnwatchedRig(names)
    here = rig.arm()
    goal = here + int(rig.stroke / 4)
    rig.ticks(5, goal)
    rig.clock.sleep_until(rig.clock.now() + 5.0)
    rig.bus.advance(rig.clock.now())
    assert rig.energised().all()
    assert abs(rig.places() - goal).max() <= 3 * rig.stroke / 100
    assert (rig.registers.watchdog == -1).all()


@pytest.mark.parametrize(
    ("names", "settings", "reason"),
    [
        (XL, {"control_mode": 1}, "wheel never stops"),
        (XL, {"shutdown": 4}, "lacks overload, overheating"),
        (XL, {"max_torque": 0}, "not move"),
        (XL, {"status_return_level": 1}, "confirms no write"),
        (XL, {"max_voltage_limit": 65}, "supply voltage"),
        (PRO, {"operating_mode": 4}, r"not 3 \(position\)"),
        (PRO, {"shutdown": 4}, "lacks overload"),
        (PRO, {"torque_limit": 0}, "not move"),
    ],
)
def test_what_must_not_get_torque_is_refused(names: list[str], settings: dict[str, int], reason: str) -> None:
    rig = UnwatchedRig(names, settings)
    with pytest.raises(DeviceRefused, match=reason):
        rig.beside(rig.writer.prepare(rig.positions()))
    assert not rig.energised().any()


def test_an_alarm_of_an_xl320_sets_its_torque_limit_to_0_and_a_restart_ends_that() -> None:
    rig = UnwatchedRig(XL)
    here = rig.arm()
    rig.faults.damage(2, 0x01)
    samples = rig.ticks(30, here)
    rig.faults.damage(2, 0)
    assert rig.servos.get(1, "torque_limit") == 0
    assert any(sample.error[1] == 0x80 for sample in samples)
    rig.ticks(10, here)
    assert rig.registers.fault[1] == SHUT_DOWN | 0x01
    assert rig.registers.torque.tolist() == [1, 0, 1]
    with pytest.raises(DeviceRefused, match=r"overload.*restart it"):
        rig.beside(rig.writer.prepare(here, np.array([False, True, False])))
    rig.beside(rig.writer.reboot(2, shut_down=True))
    rig.beside(both(rig, rig.tick().position))
    rig.beside(rig.writer.torque(True))
    rig.ticks(20)
    assert rig.registers.fault[1] == 0
    assert rig.servos.get(1, "torque_limit") == 1023


def test_a_shutdown_of_a_pro_r_lasts_until_a_restart() -> None:
    rig = UnwatchedRig(PRO)
    here = rig.arm()
    rig.faults.damage(2, 0x20)
    rig.ticks(30, here)
    rig.faults.damage(2, 0)
    assert rig.energised().tolist() == [True, False, True]
    assert rig.registers.fault[1] == 0x20
    rig.beside(rig.writer.reboot(2))
    rig.ticks(20)
    assert rig.registers.fault[1] == 0


@pytest.mark.parametrize(
    ("names", "register", "soft", "full"), [(XL, "torque_limit", 306, 1023), (PRO, "goal_torque", 186, 620)]
)
def test_torque_begins_low_and_damping_is_taken_back_by_preparing(
    names: list[str], register: str, soft: int, full: int
) -> None:
    rig = UnwatchedRig(names)
    here = rig.positions()
    rig.beside(both(rig, here))
    assert [rig.servos.get(row, register) for row in range(3)] == [soft] * 3
    rig.beside(rig.writer.torque(True))
    assert [rig.servos.get(row, register) for row in range(3)] == [full] * 3
    assert rig.beside(rig.writer.damp()) == ()
    assert (rig.servos.get(0, register), rig.servos.get(0, "position_p_gain")) == (soft, 4)
    rig.beside(rig.writer.prepare(here))
    assert (rig.servos.get(0, register), rig.servos.get(0, "position_p_gain")) == (full, 32)


def test_speed_and_load_of_an_xl320_have_their_direction_in_bit_10() -> None:
    rig = UnwatchedRig(XL)
    here = rig.arm()
    up = max(int(rig.tick(here + 400).velocity.max()) for _ in range(20))
    rig.ticks(100, here + 400)
    down = min(int(rig.tick(here).velocity.min()) for _ in range(20))
    assert up == -down == pytest.approx(114.0 / 0.111, rel=0.02), "no-load speed at 7.4 V"


def test_positions_of_a_pro_r_are_signed() -> None:
    rig = UnwatchedRig(PRO)
    here = rig.arm()
    goal = here - np.array([60_000, 40_000, 40_000])
    rig.ticks(200, goal)
    sample = rig.tick(goal)
    assert (sample.position < -30_000).all()
    assert abs(sample.position - goal).max() <= 600


@BUSES
def test_eeprom_is_written_with_torque_off_and_some_registers_never(names: list[str]) -> None:
    rig = UnwatchedRig(names)
    rig.positions()
    assert rig.beside(rig.writer.write(2, "return_delay_time", 4)).value == 4
    rig.arm()
    with pytest.raises(DeviceRefused, match="disarm"):
        rig.beside(rig.writer.write(2, "return_delay_time", 6))
    for name in ("id", "goal_position", "present_position", "baud_rate"):
        with pytest.raises(ValueError):
            rig.beside(rig.writer.write(2, name, 1))


@pytest.mark.parametrize(
    ("address", "data"),
    [(3, b"\7"), (6, b"\0\0"), (30, b"\xff\x1f"), (24, b"\2"), (37, b"\0\0"), (100, b"\0")],
)
def test_the_last_check_lets_no_other_write_out(address: int, data: bytes) -> None:
    rig = UnwatchedRig(XL)
    before = rig.sent()
    for request in (WriteRequest({1: data}, address), WriteRequest({9: b"\0"}, 25)):
        with pytest.raises(WireRangeError):
            rig.writer.begin(request, 0.0)
    assert rig.sent() == before


def test_models_of_two_tables_do_not_share_a_bus() -> None:
    with pytest.raises(ValueError, match="one register table"):
        UnwatchedRig(["XL-320", "M42-10-S260-R"])


@pytest.mark.parametrize("name", list(models()))
def test_a_servo_is_as_fast_as_its_page_says(name: str) -> None:
    rig = UnwatchedRig([name])
    own = model(name)
    here = rig.arm()
    speeds = [rig.tick(here + int(own.turn / 3)).velocity.max() for _ in range(30)]
    assert max(speeds) * own.velocity == pytest.approx(own.strength(own.volts)[1], rel=0.02)
    assert own.strength(own.volts)[1] < 120.0 * math.tau / 60.0


def test_another_model_is_named_and_gets_no_torque() -> None:
    rig = UnwatchedRig(XL)
    rig.servos.put(1, "model_number", 1060)
    device = rig.perform(rig.reader.identify())[1]
    assert (device.model_number, device.model_name, device.settings) == (1060, "XL430-W250", {})
    with pytest.raises(DeviceRefused, match="1060 has other registers"):
        rig.beside(rig.writer.prepare(rig.positions()))
    assert not rig.energised().any()
