"""The contract of the drivers: what an error says, what is not known yet, and a script run to its end."""

import numpy as np
import pytest

from tests.support.two_bus_rig import TwoBuses
from twind_drivers.bus import (
    PingRequest,
    ReadRequest,
    Script,
    SlowRegisterValues,
    WriteRequest,
)
from twind_drivers.run_script import perform


def test_registers_never_read_are_unknown_and_infinitely_old() -> None:
    unknown = SlowRegisterValues.unknown(3)
    for array in (unknown.torque, unknown.fault, unknown.watchdog):
        assert array.tolist() == [-1] * 3
    assert np.isnan(unknown.voltage).all()
    assert np.isnan(unknown.temperature).all()
    assert (unknown.status_time == -np.inf).all()
    assert (unknown.health_time == -np.inf).all()
    unknown.torque[0] = 1
    assert SlowRegisterValues.unknown(3).torque[0] == -1


# ------------------------------------------------------------------------------------- perform


@pytest.fixture
def world() -> TwoBuses:
    return TwoBuses()


def test_a_silent_device_costs_its_timeout_and_no_more(world: TwoBuses) -> None:
    def script() -> Script[list[int]]:
        found = []
        for id in (1, 9, 2):
            found += list((yield PingRequest(id)).data)
        return found

    reader = world.open("left")
    begin = world.clock.now()
    assert perform(reader, script(), world.clock) == [1, 2]
    assert 0.0 < world.clock.now() - begin < 0.01


def test_a_script_that_writes_needs_a_writer(world: TwoBuses) -> None:
    def script() -> Script[bytes]:
        yield WriteRequest({1: b"\1"}, 65)  # LED
        return (yield ReadRequest((1,), 65, 1)).data[1]

    reader = world.open("left")
    with pytest.raises(TypeError, match=r"left: Write.* opened read-only"):
        perform(reader, script(), world.clock)
    assert perform(reader, script(), world.clock, world.enable(reader)) == b"\1"
