"""From a robot file to an open bus: real ports taken and given back, and a clamp that is the hard range."""

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.support.dynamixel_responder import Servos, Wire
from twind.config.driver_family import BusDriver, BusSetup
from twind.config.robot_file import load_robot
from twind.loop.bus import bus_opener
from twind.loop.bus.bus_opener import BusOpener
from twind.loop.bus.bus_tap import TappedChannel, TappedTransport
from twind.twin.binding import bind
from twind_drivers.bus import PortError, WireRangeError
from twind_drivers.dynamixel.dynamixel_reader import DynamixelReader
from twind_drivers.ports.channel import CanChannelStatus
from twind_drivers.ports.serial_port import SerialTransport

ROBOT = load_robot("h24-split")
JOINTS = bind(ROBOT, None).joint_map
FIRST, SECOND = (bus.name for bus in JOINTS.buses)


@pytest.fixture
def ports() -> Iterator[list[str]]:
    """Two pseudo-terminals."""
    pairs = [os.openpty() for _ in range(2)]
    yield [os.ttyname(slave) for _, slave in pairs]
    for pair in pairs:
        for fd in pair:
            os.close(fd)


def made(first: str | None, second: str | None) -> BusOpener:
    return BusOpener(ROBOT, JOINTS, {FIRST: first, SECOND: second}, 100.0)


def test_each_bus_opens_its_own_port_with_its_own_servos(ports: list[str]) -> None:
    buses = made(*ports)
    for place, bus in enumerate(JOINTS.buses):
        reader = buses.open(bus.name)
        assert reader.name == bus.name
        assert reader.ids == bus.ids
        assert reader.transport.name == ports[place]
        reader.transport.close()


def test_a_port_is_ours_alone_while_it_is_open(ports: list[str]) -> None:
    buses = made(*ports)
    reader = buses.open(FIRST)
    with pytest.raises(PortError, match=f"in use by .*{os.getpid()}"):
        buses.open(FIRST)
    reader.transport.close()
    buses.open(FIRST).transport.close()


def test_ports_that_can_be_had_are_given_back_by_the_look(ports: list[str]) -> None:
    before = sorted(os.listdir("/proc/self/fd"))
    buses = made(*ports)
    buses.refuse_taken()
    buses.refuse_taken()
    assert sorted(os.listdir("/proc/self/fd")) == before


@pytest.mark.parametrize("place", [0, 1])
def test_a_port_in_use_is_refused_before_anything_runs(ports: list[str], place: int) -> None:
    held = SerialTransport(ports[place], 1_000_000)
    with pytest.raises(PortError, match="in use by"):
        made(*ports).refuse_taken()
    held.close()


def test_a_port_that_is_not_there_yet_or_not_given_is_no_failure(ports: list[str], tmp_path: Path) -> None:
    made(str(tmp_path / "ttyUSB7"), None).refuse_taken()
    with pytest.raises(PortError, match="no such port"):
        made(str(tmp_path / "ttyUSB7"), None).open(FIRST)


def test_a_path_that_is_no_serial_port_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(PortError, match="not a character device"):
        made(str(tmp_path / "file"), None).refuse_taken()
    with pytest.raises(PortError, match="/dev/null"):
        made("/dev/null", None).refuse_taken()


def test_the_clamp_of_the_writer_is_the_hard_range_of_the_joints(ports: list[str]) -> None:
    buses = made(*ports)
    for bus in JOINTS.buses:
        reader = buses.open(bus.name)
        assert isinstance(reader, DynamixelReader)
        writer = buses.enable(reader)
        writer.goals(bus.lower)
        writer.goals(bus.upper)
        for place in range(len(bus.ids)):
            for beyond in (bus.lower[place] - 1, bus.upper[place] + 1):
                goals = bus.lower.copy()
                goals[place] = beyond
                with pytest.raises(WireRangeError, match=f"id {bus.ids[place]}: goal {beyond} outside"):
                    writer.goals(goals)
        reader.transport.close()


def test_the_bus_is_timed_by_its_baud_and_its_slowest_servo(ports: list[str]) -> None:
    buses = made(*ports)
    reader = buses.open(FIRST)
    assert isinstance(reader, DynamixelReader)
    assert reader.line.baud == ROBOT.bus(FIRST).baud
    delays = [joint.type.return_delay_us for joint in ROBOT.joints if joint.bus == FIRST]
    assert reader.line.return_delay_s == pytest.approx(max(delays) * 1e-6)
    assert len(reader.ids) == int(np.size(JOINTS.buses[0].joints))
    reader.transport.close()


@pytest.mark.parametrize("one_write", [True, False])
def test_whether_goals_and_request_leave_together_is_the_robot_files(one_write: bool) -> None:
    robot = replace(ROBOT, buses=tuple(replace(bus, one_write=one_write) for bus in ROBOT.buses))
    reader = BusOpener(robot, JOINTS, {FIRST: None, SECOND: None}, 100.0).reader(FIRST, Wire(Servos(())))
    assert isinstance(reader, DynamixelReader)
    assert reader.line.one_write is one_write


# ------------------------------------------------------------------------------------- ports of both media

MIXED = load_robot("h24-mixed")
MIXED_JOINTS = bind(MIXED, None).joint_map
SERIAL, CAN, OTHER = "upper", "l_leg", "r_leg"
PORTS = {SERIAL: "/dev/null", CAN: "can:slcan:/dev/ttyACM0", OTHER: None}


class OpenedPort:
    """A port in place of a real one: how it was opened, and whether it was given back."""

    def __init__(self, *how: Any, by_signal: bool = False) -> None:
        self.how = (*how, by_signal)
        self.closed = False

    def close(self) -> None:
        self.closed = True


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[OpenedPort]:
    """Every port that is opened, serial or CAN."""
    found: list[OpenedPort] = []

    def opener(medium: str) -> Any:
        def open_port(port: str, rate: int, **how: bool) -> OpenedPort:
            found.append(OpenedPort(medium, port, rate, **how))
            return found[-1]

        return open_port

    monkeypatch.setattr(bus_opener, "SerialTransport", opener("serial"))
    monkeypatch.setattr(bus_opener, "open_channel", opener("can"))
    return found


def mixed(**more: Any) -> BusOpener:
    return BusOpener(MIXED, MIXED_JOINTS, PORTS, 100.0, **more)


@pytest.mark.parametrize(("bus", "medium", "rate"), [(SERIAL, "serial", 1_000_000), (CAN, "can", 1_000_000)])
def test_the_loop_opens_a_port_of_its_medium_and_waits_for_its_bytes_by_signal(
    opened: list[OpenedPort], monkeypatch: pytest.MonkeyPatch, bus: str, medium: str, rate: int
) -> None:
    monkeypatch.setattr(BusOpener, "reader", lambda self, name, port: (name, port))
    reader: Any = mixed().open(bus)
    [port] = opened
    assert reader == (bus, port)
    assert port.how == (medium, PORTS[bus], rate, True)


@pytest.mark.parametrize("there", [False, True])
def test_ports_of_both_media_that_are_there_are_opened_once_and_given_back(
    opened: list[OpenedPort], monkeypatch: pytest.MonkeyPatch, there: bool
) -> None:
    monkeypatch.setattr(bus_opener, "present", lambda port: there)
    monkeypatch.setattr(bus_opener.Path, "exists", lambda path: there)
    mixed().refuse_taken()
    assert [port.how[:2] for port in opened] == [("serial", "/dev/null"), ("can", PORTS[CAN])] * there
    assert all(port.closed for port in opened)


def test_the_bytes_of_a_bus_with_a_recorder_are_recorded() -> None:
    serial: Any = Wire(Servos(()))
    unused = dict.fromkeys(("fileno", "arrival", "close", "drive", "purge"))
    channel = SimpleNamespace(name="can", warning="", condition=CanChannelStatus(), **unused)
    tape: Any = object()
    for bus, port, kind in ((SERIAL, serial, TappedTransport), (CAN, channel, TappedChannel)):
        assert type(mixed(tapes={bus: tape}).reader(bus, port).transport) is kind
        assert mixed().reader(bus, port).transport is port


class DriverStandIn:
    """A driver that returns what it receives on its bus."""

    def __init__(self) -> None:
        self.loaded = 0

    def load(self) -> BusDriver:
        self.loaded += 1
        return BusDriver(lambda setup, port: setup, lambda setup, reader: setup)  # type: ignore[arg-type, return-value]


def test_drivers_are_imported_before_the_first_tick(monkeypatch: pytest.MonkeyPatch) -> None:
    driver = DriverStandIn()
    monkeypatch.setattr(bus_opener, "family", lambda kind: SimpleNamespace(driver=driver))
    mixed()
    assert driver.loaded == len(MIXED.buses)


@pytest.mark.parametrize("bus", [SERIAL, CAN])
@pytest.mark.parametrize("imu_on", [None, SERIAL])
def test_a_driver_receives_its_own_joints_and_the_imu_of_its_bus(
    monkeypatch: pytest.MonkeyPatch, bus: str, imu_on: str | None
) -> None:
    medium = SimpleNamespace(driver=DriverStandIn(), medium=None)
    monkeypatch.setattr(bus_opener, "family", lambda kind: medium)
    imu = load_robot("h24-standing").imu
    assert imu is not None
    imu = replace(imu, bus=SERIAL, id=33, return_delay_us=250)
    opener = replace(mixed(), robot=replace(MIXED, imu=None if imu_on is None else imu))
    setup: Any = opener.reader(bus, None)
    assert isinstance(setup, BusSetup)
    assert setup.bus.name == bus
    assert [joint.bus for joint in setup.joints] == [bus] * len(setup.ids)
    assert setup.ids == next(each.ids for each in MIXED_JOINTS.buses if each.name == bus)
    assert setup.rate_hz == 100.0
    assert setup.sensors == ({33: pytest.approx(250e-6)} if bus == imu_on else {})
