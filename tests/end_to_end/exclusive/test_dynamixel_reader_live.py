"""Real-time tests of dynamixel reader."""

import pytest

from tests.support.dynamixel_reader_rig import pose
from tests.support.dynamixel_responder import PtyServos, Servos
from twind_drivers.bus import (
    PortError,
)
from twind_drivers.clock import MonotonicClock
from twind_drivers.dynamixel.dynamixel_reader import DynamixelReader
from twind_drivers.ports.serial_port import SerialTransport
from twind_drivers.run_script import perform

IDS = tuple(range(1, 25))


def test_cycles_over_a_real_pseudo_terminal_and_its_unplugging() -> None:
    servos = Servos(IDS)
    pose(servos)
    with PtyServos(servos) as other:
        port = SerialTransport(other.path, 2_000_000)
        reader = DynamixelReader("main", port, IDS, [1020] * 24, baud=2_000_000, return_delay_us=0, slack=0.5)
        clock = MonotonicClock()
        devices = perform(reader, reader.identify(), clock)
        assert len(devices) == 24
        assert reader.fast
        for _ in range(50):
            reader.request(clock.now())
            while not reader.feed(clock.now()) and clock.now() < reader.deadline:
                clock.wait([port], reader.deadline)
            sample = reader.finish(clock.now())
            assert sample.heard.all()
            assert sample.position[3] == 99_996
        other.end()
        with pytest.raises(PortError) as caught:
            reader.request(clock.now())
        assert caught.value.lost
        port.close()
