"""Register 70 by physics: e-manual, "Shutdown" names the errors; the models are ours (see the module)."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.virtual_serial_host import Host
from twind_drivers.dynamixel import packet
from twind_drivers.dynamixel.control_tables import number_of, table
from twind_drivers.virtual.servo_protection import BEARABLE, ServoProtection, ampere

ALERT = 0x80
VOLTAGE = 1
HEAT = 4
OVERLOAD = 32


def on_its_own(model: str = "XM430-W350") -> ServoProtection:
    protection = ServoProtection([table(number_of(model), 47)])
    protection.watch(np.array([80.0]), np.array([9.5]), np.array([16.0]))
    return protection


def errors(protection: ServoProtection) -> int:
    return int(protection.errors()[0])


def test_the_current_unit_is_the_model_s() -> None:
    """e-manual, "Present Current": 2.69 mA (XM, XH, X540), 1 mA (X330), 3.36 mA (MX-106, MX-64 2.0)."""
    for model, unit in (("XM430-W350", 2.69), ("XH540-W270", 2.69), ("XL330-M288", 1.0), ("MX-64", 3.36)):
        assert ampere(table(number_of(model), 47)) == pytest.approx(unit * 1e-3)


def test_a_stalled_motor_is_overloaded_after_a_second_and_a_bearable_load_never() -> None:
    """DynamixelSDK #285: 41 % of the stall current is overload after a while."""
    for share, seconds in ((1.0, 1.0), (0.5, 7.0), (0.41, 19.2)):
        protection = on_its_own()
        now = 0.0
        while not errors(protection) & OVERLOAD:
            now += 0.1
            protection.step(now, np.array([-855.0 * share]))
        assert now == pytest.approx(seconds, rel=0.02, abs=0.11)
    protection = on_its_own()
    protection.step(3600.0, np.array([855.0 * BEARABLE * 0.999]))
    assert not errors(protection) & OVERLOAD


def test_bursts_with_rests_between_them_are_no_overload() -> None:
    protection = on_its_own()
    for k in range(200):
        protection.step(0.1 * (k + 1), np.array([800.0 if k % 12 == 0 else 0.0]))
        assert not errors(protection) & OVERLOAD


@given(st.lists(st.floats(0.01, 100), min_size=1, max_size=8), st.floats(0, 900))
def test_warmth_does_not_depend_on_how_often_one_looks(steps: list[float], current: float) -> None:
    many = on_its_own()
    once = on_its_own()
    for end in np.cumsum(steps):
        many.step(float(end), np.array([current]))
    once.step(float(np.cumsum(steps)[-1]), np.array([current]))
    assert many.celsius[0] == pytest.approx(once.celsius[0], abs=1e-6)
    assert 25.0 <= once.celsius[0] <= 25.0 + 20.0 * (current * 0.00269) ** 2 + 1e-6


def test_a_servo_warms_with_the_square_of_the_current_and_cools_again() -> None:
    protection = on_its_own()
    protection.step(3600.0, np.array([1.0 / 0.00269]))
    assert protection.celsius[0] == pytest.approx(45.0, abs=0.01)
    protection.step(3600.0 + 180.0, np.array([0.0]))
    assert protection.celsius[0] == pytest.approx(25.0 + 15.0 / np.e, abs=0.1)
    protection.step(9999.0, np.array([0.0]))
    assert protection.celsius[0] == pytest.approx(25.0, abs=0.01)


@pytest.mark.parametrize("volts", [-1.0, 60.1, float("nan"), float("inf")])
def test_a_supply_that_is_none_is_refused(volts: float) -> None:
    with pytest.raises(ValueError, match=r"outside 0\.\.60 V"):
        on_its_own().supply(volts)


@pytest.mark.parametrize("celsius", [-41.0, 201.0, float("nan")])
def test_a_temperature_that_is_none_is_refused(celsius: float) -> None:
    with pytest.raises(ValueError, match=r"outside -40\.\.200"):
        on_its_own().heat(0, celsius)


# ---------------------------------------------------------------------- on the bus


def status(host: Host, id: int = 1) -> tuple[int, int, int]:
    """Alert bit, register 70, torque enable."""
    (answer,) = host.ask(packet.read(id, 70, 1))
    return answer.error & ALERT, answer.data[0], host.read(id, 64, 1)


def test_a_blocked_shaft_ends_in_an_overload_shutdown_that_only_a_reboot_ends() -> None:
    """e-manual, "Shutdown": 63 and 70; torque off, output 0, alert on every status until the reboot."""
    host = Host([1, 2])
    host.torque(1)
    host.torque(2)
    host.servos.block(0, True)
    host.goal(1, 3500)
    host.goal(2, 3500)
    host.wait(0.5)
    assert host.read(1, 126, 2) > 800
    assert status(host) == (0, 0, 1)
    host.wait(1.0)
    assert status(host) == (ALERT, OVERLOAD, 0)
    assert (host.read(1, 126, 2), host.read(1, 124, 2)) == (0, 0)
    assert status(host, 2) == (0, 0, 1)
    assert host.write(1, 64, 1, 1) == ALERT
    assert status(host) == (ALERT, OVERLOAD, 0), "rewriting torque enable does nothing"
    host.servos.block(0, False)
    host.ask(packet.reboot(1))
    host.wait(0.3)
    assert status(host) == (0, 0, 0)
    host.torque(1)
    assert status(host) == (0, 0, 1)


def test_a_reboot_resets_the_overload_of_a_servo() -> None:
    """Assumed: else a blocked joint would be shut down again the moment that it is armed."""
    host = Host([1])
    host.servos.block(0, True)
    for _ in range(2):
        host.torque(1)
        host.goal(1, 3500)
        host.wait(0.8)
        assert status(host) == (0, 0, 1)
        host.wait(0.5)
        assert status(host) == (ALERT, OVERLOAD, 0)
        host.ask(packet.reboot(1))
        host.wait(0.11)


def test_an_overload_that_the_mask_leaves_out_alerts_and_goes_on_pulling() -> None:
    """e-manual, "Shutdown": what is not in 63 does not shut down (jsk_aerial_robot #281 relies on it)."""
    host = Host([1], settings={"shutdown": 0})
    host.torque(1)
    host.servos.block(0, True)
    host.goal(1, 3500)
    host.wait(2.0)
    assert status(host) == (ALERT, OVERLOAD, 1)
    assert host.read(1, 126, 2) > 800


def test_a_goal_current_that_it_can_bear_is_never_an_overload() -> None:
    host = Host([1], settings={"operating_mode": 5})
    host.write(1, 102, 250, 2)
    host.torque(1)
    host.servos.block(0, True)
    host.goal(1, 3500)
    for _ in range(60):
        host.wait(1.0)
    assert host.read(1, 126, 2) == 250
    assert status(host) == (0, 0, 1)


def test_a_servo_at_its_temperature_limit_shuts_down() -> None:
    """e-manual, "Temperature Limit" (31): beyond it, overheating error."""
    host = Host([1], settings={"temperature_limit": 60})
    host.torque(1)
    host.servos.protection.heat(0, 59.0)
    host.wait(0.2)
    assert host.read(1, 146, 1) == 59
    assert status(host) == (0, 0, 1)
    host.servos.protection.heat(0, 60.0)
    host.wait(0.2)
    assert status(host) == (ALERT, HEAT, 0)
    host.ask(packet.reboot(1))
    host.wait(0.5)
    assert status(host)[1] == HEAT, "as long as it is hot the error comes back"
    assert host.write(1, 64, 1, 1) == ALERT
    assert host.read(1, 64, 1) == 0


def test_a_supply_outside_the_limits_is_an_error_that_only_the_x330_shuts_down_for() -> None:
    """e-manual, "Shutdown" of XM430 (52) and XL330 (53), "Min/Max Voltage Limit" (34, 32)."""
    for model, good, bad, torque in (("XM430-W350", 12.0, 9.4, 1), ("XL330-M288", 5.0, 7.1, 0)):
        host = Host([1], model=model)
        host.torque(1)
        host.servos.supply(good)
        assert status(host) == (0, 0, 1)
        host.servos.supply(bad)
        host.wait(0.2)
        assert host.read(1, 144, 2) == round(bad * 10)
        assert status(host) == (ALERT, VOLTAGE, torque)


def test_a_servo_for_less_than_its_bus_is_fed_through_a_converter_that_steps_down_alone() -> None:
    host = Host([1, 2], model=["XL430-W250", "XL330-M288"])
    for supply, stepped_down in ((12.0, 5.0), (14.0, 5.0), (4.0, 4.0), (0.0, 0.0), (12.0, 5.0)):
        host.servos.supply(supply)
        assert host.servos.protection.connector_volts.tolist() == [supply, stepped_down]


def test_a_brown_out_reboots_a_servo_and_without_supply_it_stays_off() -> None:
    """As a reboot: silence, RAM defaults, torque off, turns lost."""
    host = Host([1, 2], settings={"operating_mode": 4})
    for id in (1, 2):
        host.write(id, 84, 1600, 2)
        host.torque(id)
        host.goal(id, 5000)
    host.wait(5.0)
    assert host.present(1) == 5000
    host.servos.supply(5.9)
    for _ in range(40):
        assert host.ask(packet.ping(1)) == []
        host.wait(0.07)
    host.servos.supply(12.0)
    host.wait(0.3)
    for id in (1, 2):
        assert [host.read(id, *at) for at in ((84, 2), (64, 1), (70, 1))] == [800, 0, 0]
        assert host.present(id) == 5000 - 4096


def test_the_supply_sags_by_what_all_servos_draw_and_they_draw_less() -> None:
    """V = 12 V - 0.05 Ω x 10 x 2.1 A x V / 11.1 V, as the page says for 11.1 V."""
    host = Host(range(1, 11))
    for id in range(1, 11):
        host.torque(id)
        host.servos.block(id - 1, True)
        host.goal(id, 4000)
    host.wait(0.5)
    volts = 12.0 / (1.0 + 10 * 2.1 * 0.05 / 11.1)
    assert host.read(1, 144, 2) == pytest.approx(10 * volts, abs=1)
    assert host.read(1, 126, 2) == pytest.approx(2.1 / 0.00269 * volts / 11.1, rel=0.01)


def test_less_supply_is_a_slower_servo() -> None:
    reached = []
    for volts in (12.0, 10.0):
        host = Host([1])
        host.servos.supply(volts)
        host.torque(1)
        host.goal(1, 4000)
        host.wait(0.3)
        reached.append(host.present(1) - 2048)
    assert reached[1] == pytest.approx(reached[0] * 10 / 12, rel=0.05)


def test_encoder_and_shock_errors_come_on_order_only() -> None:
    host = Host([1])
    host.torque(1)
    host.bus.faults.damage(1, 8)
    assert status(host) == (ALERT, 8, 1), "the encoder bit is not in 52"
    host.bus.faults.damage(1, 16)
    assert status(host) == (ALERT, 24, 0)


def test_servos_that_pull_their_own_supply_down_brown_out_unasked() -> None:
    """A weak supply under 24 blocked servos: 1.6 V of sag take 6.8 V below what the controllers need."""
    host = Host(range(1, 25))
    host.servos.supply(6.8)
    for id in range(1, 25):
        host.write(id, 64, 1, 1)
        host.servos.block(id - 1, True)
    assert host.read(24, 64, 1) == 1
    host.raw(packet.sync_write(116, {id: (4000).to_bytes(4, "little") for id in range(1, 25)}))
    host.wait(0.15)
    assert host.ask(packet.ping(1)) == []
    host.wait(0.3)
    assert [host.read(id, 64, 1) for id in (1, 24)] == [0, 0]
