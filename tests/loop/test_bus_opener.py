"""From a robot file to an open bus: real ports taken and given back, and a clamp that is the hard range."""

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.dynamixel_responder import Servos, Wire
from twind.config.robot_file import load_robot
from twind.loop.bus.bus_opener import BusOpener
from twind.twin.binding import bind
from twind_drivers.bus import PortError, WireRangeError
from twind_drivers.dynamixel.dynamixel_reader import DynamixelReader
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
