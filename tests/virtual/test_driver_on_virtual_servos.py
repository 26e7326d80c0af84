"""Our own driver on the virtual servos, in process under a fake clock: both sides speak real bytes."""

import numpy as np
import pytest

from tests.support.virtual_serial_host import Host
from twind_drivers.bus import BusSample
from twind_drivers.dynamixel.dynamixel_bus import DynamixelReader, DynamixelWriter
from twind_drivers.run_script import perform
from twind_drivers.virtual.serial_loopback import Loopback

IDS = tuple(range(1, 25))
FIRST = np.zeros(24, np.int64)
LAST = np.full(24, 4095, np.int64)


class Rig:
    def __init__(self) -> None:
        self.host = Host(IDS)
        self.clock = self.host.clock
        self.reader = DynamixelReader(
            "main",
            Loopback(self.host.bus, self.clock),
            IDS,
            [1020] * 24,
            baud=2_000_000,
            return_delay_us=0,
        )
        self.writer = DynamixelWriter(self.reader, lower=FIRST, upper=LAST)
        self.start = np.full(24, 2048, np.int64)
        self.devices = self.perform(self.reader.identify())

    def perform(self, script):
        return perform(self.reader, script, self.clock, self.writer)

    def arm(self) -> None:
        self.perform(self.writer.prepare(self.start))
        self.perform(self.writer.torque(True))

    def tick(self, goal: np.ndarray | None = None) -> BusSample:
        begin = self.clock.now()
        if goal is not None:
            self.writer.goals(goal)
        self.reader.request(begin)
        self._wait()
        sample = self.reader.finish(self.clock.now())
        self.reader.begin(self.reader.upkeep(self.clock.now()), self.clock.now())
        self._wait()
        self.reader.answer(self.clock.now())
        self.clock.sleep_until(begin + 0.01)
        return sample

    def _wait(self) -> None:
        while not self.reader.feed(self.clock.now()) and self.clock.now() < self.reader.deadline:
            self.clock.wait([self.reader.transport], self.reader.deadline)


def test_the_driver_identifies_all_servos_with_their_settings() -> None:
    rig = Rig()
    assert [device.id for device in rig.devices] == list(IDS)
    assert {device.model_name for device in rig.devices} == {"XM430-W350"}
    assert {device.settings["operating_mode"] for device in rig.devices} == {3}
    assert rig.reader.fast, "firmware 47 knows the fast read"


def test_armed_servos_follow_a_path_and_every_reading_is_fast_and_whole() -> None:
    rig = Rig()
    rig.arm()
    for k in range(200):
        goal = rig.start + round(300 * np.sin(k / 30))
        sample = rig.tick(goal)
        assert sample.heard.all()
        assert sample.discarded == 0
    assert np.abs(sample.position - goal).max() < 60
    assert (rig.reader.registers.watchdog == 5).all()
    assert (rig.reader.registers.torque == 1).all()
    assert not rig.host.servos.tripped.any()


def test_a_servo_without_a_reply_is_not_fresh_and_the_others_are() -> None:
    rig = Rig()
    rig.arm()
    rig.host.bus.faults.silence(12)
    samples = [rig.tick(rig.start) for _ in range(20)]
    assert not any(sample.heard[11] for sample in samples)
    assert all(sample.heard.sum() == 23 for sample in samples[2:]), "by plain reads"


def test_arming_after_a_dead_writer_does_not_jump_to_the_old_goal() -> None:
    rig = Rig()
    rig.arm()
    for _ in range(5):
        rig.tick(rig.start + 900)
    rig.host.wait(0.5)
    assert rig.host.servos.tripped.all()
    here = rig.host.muscles.position.copy()
    rig.start = np.rint(here).astype(np.int64)
    rig.arm()
    assert not rig.host.servos.tripped.any()
    for _ in range(20):
        rig.tick(rig.start)
    assert np.abs(rig.host.muscles.position - here).max() < 25, "resumed for the 1 ms between two packets"


@pytest.mark.parametrize("fault", ["drop", "corrupt", "foreign"])
def test_line_faults_cost_a_reading_and_never_give_a_wrong_one(fault: str) -> None:
    rig = Rig()
    rig.host.muscles.position += np.arange(24) * 10.0
    rig.tick()
    for count in (1, 3, 30):
        getattr(rig.host.bus.faults, fault)(count)
        for _ in range(10):
            sample = rig.tick()
            assert (sample.position[sample.heard] == (2048 + np.arange(24) * 10)[sample.heard]).all()
    assert rig.tick().heard.all()
