"""Y servos on the virtual bus: their own table, error codes and watchdog."""

import numpy as np
import pytest

from tests.support.driver_rig import DriverRig
from tests.support.feetech_rig import Counted
from tests.support.virtual_serial_host import Host
from twind_drivers.bus import TRIPPED, DeviceRefused
from twind_drivers.dynamixel.control_tables import number_of, table
from twind_drivers.dynamixel.dynamixel_models import facts
from twind_drivers.dynamixel.dynamixel_reader import DynamixelReader
from twind_drivers.dynamixel.dynamixel_writer import DynamixelWriter
from twind_drivers.dynamixel.error_codes import BITS_BY_CODE

R099 = "YM070-210-R099"
MIXED = [R099, "YM080-230-R051", "PH42-020-S300"]


class YRig(DriverRig):
    """Servos at count 0, limp, at 2 Mbaud."""

    def __init__(self, models: list[str]) -> None:
        ids = tuple(range(1, len(models) + 1))
        self.host = Host(ids, model=models, start=0.0)
        self.clock = self.host.clock
        self.faults = self.host.bus.faults
        self.port = Counted(self.host.bus, self.clock)
        self.lower = np.full(len(ids), -100_000, np.int64)
        self.upper = np.full(len(ids), 100_000, np.int64)
        self.reader: DynamixelReader = DynamixelReader(
            "arm", self.port, ids, [number_of(each) for each in models], baud=2_000_000, return_delay_us=0
        )
        self.writer: DynamixelWriter = DynamixelWriter(self.reader, lower=self.lower, upper=self.upper)

    def places(self) -> np.ndarray:
        return np.rint(self.host.muscles.position).astype(np.int64)

    def energised(self) -> np.ndarray:
        return np.array([bool(on) for on in self.host.servos["torque_enable"]])

    def sent(self) -> int:
        return self.port.written


def test_the_gains_and_the_watchdog_are_no_eeprom() -> None:
    own = table(number_of(R099))
    ram = ("bus_watchdog", "position_p_gain", "profile_velocity", "torque_enable", "error_code")
    assert not any(own[name].eeprom for name in ram)
    kept = (
        "operating_mode",
        "baud_rate",
        "velocity_limit",
        "electronic_gearratio_numerator",
        "secondary_shadow_id",
    )
    assert all(own[name].eeprom for name in kept)
    assert own["hardware_error_status"].address == own["error_code"].address == 153


def test_error_codes_become_bits_and_a_tripped_watchdog_or_a_low_battery_is_none() -> None:
    status = table(number_of(R099))["hardware_error_status"]
    decoded = {code: status.decode(bytes((code,))) for code in (0, 2, 4, 5, 9, 13, 18, 20)}
    assert decoded == {0: 0, 2: 0x01, 4: 0x04, 5: 0x20, 9: 0, 13: 0x08, 18: 0, 20: 0x40}
    assert all(BITS_BY_CODE[code] for code in range(1, 256) if code not in (9, 18))


@pytest.mark.parametrize("models", [[R099] * 3, MIXED], ids=["alone", "mixed"])
def test_servos_are_identified_armed_moved_and_read(models: list[str]) -> None:
    rig = YRig(models)
    devices = rig.perform(rig.reader.identify())
    assert [each.model_name for each in devices] == models
    assert devices[0].settings["electronic_gearratio_numerator"] == 99
    assert devices[0].settings["hardware_error_status"] == 0
    here = rig.arm()
    for cycle in range(40):
        rig.tick(here + 500 * cycle)
    samples = rig.ticks(60, here + 20_000)
    assert abs(rig.places() - here - 20_000).max() < 1_000
    assert all(sample.heard.all() for sample in samples)
    state = rig.registers
    assert (state.torque.tolist(), state.fault.tolist()) == ([1, 1, 1], [0, 0, 0])
    assert state.watchdog.tolist() == [5, 5, 5]
    assert state.voltage == pytest.approx([24.0] * 3, abs=1.0)
    assert (rig.clock.now() - state.status_time < 0.07).all()
    assert rig.host.servos["goal_current"][0] == 2080, "0 would let no current through"


def test_a_tripped_watchdog_holds_is_no_alert_and_preparing_ends_it() -> None:
    rig = YRig([R099] * 2)
    here = rig.arm()
    rig.clock.sleep_until(rig.clock.now() + 0.5)
    rig.host.bus.advance(rig.clock.now())
    assert rig.host.servos.tripped.all()
    assert rig.energised().all()
    samples = rig.ticks(20, here + 5_000)
    assert rig.registers.watchdog.tolist() == [TRIPPED] * 2
    assert rig.registers.fault.tolist() == [0, 0]
    assert not any(sample.error.any() for sample in samples)
    assert abs(rig.places() - here).max() < 100
    rig.beside(rig.writer.prepare(rig.tick().position))
    rig.ticks(60, here + 5_000)
    assert abs(rig.places() - here - 5_000).max() < 500


def test_an_error_is_an_alert_once_its_code_is_read() -> None:
    rig = YRig([R099] * 2)
    here = rig.arm()
    rig.faults.damage(2, 0x20)
    samples = rig.ticks(20, here)
    assert rig.registers.fault.tolist() == [0, 0x20]
    assert samples[-1].error.tolist() == [0, 0x80]
    assert rig.registers.torque.tolist() == [1, 0]


def test_damping_lowers_output_and_p_gain() -> None:
    rig = YRig([R099])
    rig.arm()
    assert rig.beside(rig.writer.damp()) == ()
    assert rig.host.servos["goal_pwm"][0] == 300
    assert rig.host.servos["position_p_gain"][0] == 6_283_185 // 8


@pytest.mark.parametrize("level", [1, 2])
def test_a_restart_gives_back_gains_profile_times_and_status_level(level: int) -> None:
    rig = YRig([R099])
    wanted = {
        "position_p_gain": 777,
        "velocity_ff_gain": 123,
        "position_ff_gain": 45,
        "profile_acceleration_time": 67,
        "profile_time": 89,
        "status_return_level": level,
    }
    for name, value in wanted.items():
        rig.beside(rig.writer.write(1, name, value))
    assert rig.beside(rig.writer.reboot(1)).differing == ()
    assert {name: rig.beside(rig.reader.read(1, name)).value for name in wanted} == wanted
    assert not rig.energised().any()


def test_a_servo_that_cannot_ignore_an_error_is_restarted_as_shut_down_by_any() -> None:
    rig = YRig([R099])
    rig.host.servos.registers.put("torque_enable", 1)
    with pytest.raises(DeviceRefused, match="nothing has shut it down"):
        rig.beside(rig.writer.reboot(1, shut_down=True))
    rig.host.servos.registers.put("hardware_error_status", 5)
    rig.beside(rig.writer.reboot(1, shut_down=True))
    assert not rig.energised().any()


def test_a_wrong_mode_is_refused() -> None:
    rig = YRig([R099])
    rig.host.servos.registers.put("operating_mode", 1)
    with pytest.raises(DeviceRefused, match="operating mode"):
        rig.beside(rig.writer.prepare(rig.positions()))


@pytest.mark.parametrize(
    ("stem", "gear"), [("ym070_210_m001", 1), ("ym080_230_a051", 51), ("ym070_210_r099", 99)]
)
def test_the_counts_of_a_geared_one_are_those_of_the_output(stem: str, gear: int) -> None:
    assert facts(stem).gear == gear
    assert facts(stem).counts_per_turn == 524_288
