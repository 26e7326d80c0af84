"""Every mode that the writer drives, mixed on one bus of virtual servos: they go as they are told."""

import numpy as np
import pytest

from twind_drivers.bus import BusSample, DeviceRefused
from twind_drivers.clock import FakeClock
from twind_drivers.dynamixel.dynamixel_reader import DynamixelReader
from twind_drivers.dynamixel.dynamixel_writer import DynamixelWriter
from twind_drivers.run_script import perform
from twind_drivers.virtual.serial_loopback import Loopback
from twind_drivers.virtual.servo_physics import FirstOrderPhysics
from twind_drivers.virtual.virtual_serial_bus import VirtualBus
from twind_drivers.virtual.virtual_servos import ServoSpec

MODES = (3, 4, 5, 1, 0)
IDS = (11, 12, 13, 14, 15)
POSITION, EXTENDED, SOFT, SPEED, CURRENT = range(5)
FLOAT = {"baud_rate": 4, "return_delay_time": 0}
TICKS_PER_SECOND = 0.229 / 60 * 4096  # of one count of speed
WIDE = 1_048_575
REST = np.array([2048, 2048, 2048, 0, 0])


class Bench:
    """Five XM430, one in each mode, torque off."""

    def __init__(self) -> None:
        specs = [
            ServoSpec(id, "XM430-W350", FLOAT | {"operating_mode": mode}, 47)
            for id, mode in zip(IDS, MODES, strict=True)
        ]
        self.bus = VirtualBus("test", specs, FirstOrderPhysics(np.full(5, 2048.0)))
        self.clock = FakeClock()
        transport = Loopback(self.bus, self.clock)
        self.reader = DynamixelReader(
            "main", transport, IDS, [1020] * 5, baud=2_000_000, return_delay_us=0, fast=True
        )
        self.writer = DynamixelWriter(
            self.reader,
            modes=MODES,
            lower=np.array([0, -WIDE, -WIDE, -300, -100]),
            upper=np.array([4095, WIDE, WIDE, 300, 100]),
            current_caps=[None, None, 200, None, None],
            accelerations=[None, None, None, 0, None],
        )

    def run(self, script):
        return perform(self.reader, script, self.clock, self.writer)

    def arm(self) -> None:
        self.run(self.writer.prepare(REST))
        self.run(self.writer.torque(True))

    def go(self, goals: np.ndarray | None, seconds: float) -> BusSample:
        """Goals, if any, in every cycle of 10 ms."""
        for _ in range(round(seconds / 0.01)):
            begin = self.clock.now()
            if goals is not None:
                self.writer.goals(goals)
            self.reader.request(begin)
            while not self.reader.feed(self.clock.now()) and self.clock.now() < self.reader.deadline:
                self.clock.wait([self.reader.transport], self.reader.deadline)
            sample = self.reader.finish(self.clock.now())
            assert sample.heard.all()
            self.clock.sleep_until(begin + 0.01)
        return sample


@pytest.mark.slow
def test_each_servo_follows_goals_in_its_own_unit() -> None:
    bench = Bench()
    bench.arm()
    first = bench.go(np.array([2500, 12_000, 1500, 100, 0]), 8.0)
    assert first.position[[POSITION, EXTENDED, SOFT]] == pytest.approx([2500, 12_000, 1500], abs=3)
    assert first.velocity[SPEED] == 100
    last = bench.go(np.array([2500, 12_000, 1500, 100, 0]), 1.0)
    assert last.position[SPEED] - first.position[SPEED] == pytest.approx(100 * TICKS_PER_SECOND, rel=0.02)
    assert bench.run(bench.writer.read_goals()).tolist() == [2500, 12_000, 1500, 100, 0]


def test_a_current_drives_without_a_place_to_go() -> None:
    bench = Bench()
    bench.arm()
    still = bench.go(REST, 0.2)
    pushed = bench.go(np.array([2048, 2048, 2048, 0, 60]), 0.5)
    assert pushed.position[CURRENT] > still.position[CURRENT] + 50
    assert pushed.effort[CURRENT] > 0
    assert np.abs(pushed.position - still.position)[:CURRENT].max() <= 1


def test_torque_on_causes_no_motion_in_any_mode() -> None:
    bench = Bench()
    # goals of somebody before us, that would throw all five
    bench.bus.servos.registers.put("goal_velocity", 250, SPEED)
    bench.bus.servos.registers.put("goal_current", 90, CURRENT)
    bench.bus.servos.registers.put("goal_position", 4000, EXTENDED)
    with pytest.raises(DeviceRefused, match="id 14: goal velocity"):
        bench.run(bench.writer.torque(True))
    bench.arm()
    assert (np.asarray(bench.bus.servos["torque_enable"]) == 1).all()
    assert np.abs(bench.go(None, 0.08).position - 2048).max() <= 1


def test_a_silent_host_stops_a_speed_and_a_cut_lets_all_of_them_go() -> None:
    # e-manual, Bus Watchdog (98): on expiry the servo stops; here 5 x 20 ms
    bench = Bench()
    bench.arm()
    bench.go(np.array([2048, 2048, 2048, 200, 0]), 0.5)
    bench.clock.sleep_until(bench.clock.now() + 0.5)
    stopped = bench.go(None, 0.01).position[SPEED]
    assert stopped > 2048 + 1000, "it did turn"
    assert bench.go(None, 0.05).position[SPEED] == stopped
    bench.writer.cut()
    bench.go(None, 0.01)
    assert (np.asarray(bench.bus.servos["torque_enable"]) == 0).all()
