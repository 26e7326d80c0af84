"""The contract of the drivers: what an error says, what is not known yet, and a script run to its end."""

import numpy as np
import pytest

from tests.support.two_bus_rig import IDS, TwoBuses
from twind.exceptions import InvalidInput
from twind_drivers.bus import (
    BusError,
    DeviceRefused,
    NoReply,
    PingRequest,
    PortError,
    PortErrorCause,
    ReadRequest,
    Script,
    SlowRegisterValues,
    WireClamp,
    WriteRequest,
)
from twind_drivers.run_script import perform

ERRORS = [
    (PortError("/dev/ttyUSB0", "no such port"), "/dev/ttyUSB0: no such port"),
    (
        NoReply("main", (3, 7), 0.0021, "ping"),
        "main: no reply to ping from [3, 7] within 2.1 ms",
    ),
    (DeviceRefused("main", 3, "torque", "reads 0"), "main: id 3: torque: reads 0"),
    (
        WireClamp("main", 3, 5000, 100, 4000),
        "main: id 3: goal 5000 outside 100..4000; packet not sent",
    ),
]


@pytest.mark.parametrize(("error", "text"), ERRORS)
def test_an_error_names_the_bus_the_device_the_value_and_the_bound(error: BusError, text: str) -> None:
    assert str(error) == text
    assert isinstance(error, BusError)
    assert error.port in text


def test_a_port_that_cannot_be_opened_is_not_a_lost_one() -> None:
    assert not PortError("p", "r").lost
    assert PortError("p", "r", kind=PortErrorCause.LOST).lost


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


def test_a_script_is_run_to_its_end_and_its_result_returned(world: TwoBuses) -> None:
    reader = world.open("left")
    devices = perform(reader, reader.identify(), world.clock)
    assert [device.id for device in devices] == list(IDS["left"])


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


def test_an_error_of_the_script_comes_out(world: TwoBuses) -> None:
    reader = world.open("left")
    world.virtual["left"].faults.silence(2)
    with pytest.raises(NoReply, match=r"\[2\]"):
        perform(reader, reader.read(2, "led"), world.clock)
    with pytest.raises(InvalidInput, match="led"):
        perform(reader, reader.read(1, "ledd"), world.clock)


def test_a_lost_port_comes_out_too(world: TwoBuses) -> None:
    reader = world.open("left")
    world.virtual["left"].faults.unplug()
    with pytest.raises(PortError) as caught:
        perform(reader, reader.identify(), world.clock)
    assert caught.value.lost
