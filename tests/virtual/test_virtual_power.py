"""Relay and button of a virtual robot on pseudo-terminals."""

import os
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest

from twind.exceptions import InvalidInput
from twind.power.relay_switch import LCUS_OFF, LCUS_ON
from twind.virtual.pty_port import VirtualPtyPort
from twind.virtual.virtual_main import power_ports
from twind.virtual.virtual_power import BUTTON, RELAY, SENT, VirtualPower
from twind_drivers.clock import FakeClock


class Host:
    """A host with both ports open."""

    def __init__(self) -> None:
        self.clock = FakeClock(10.0)
        self.supply: list[bool] = []
        ports = {name: VirtualPtyPort(name, None) for name in (RELAY, BUTTON)}
        self.power = VirtualPower(ports, self.supply.append, self.clock)
        self.fds = {name: os.open(port.path, os.O_RDWR | os.O_NONBLOCK) for name, port in ports.items()}
        for fd in self.fds.values():
            tty.setraw(fd)

    def send(self, data: bytes) -> bool:
        os.write(self.fds[RELAY], data)
        self.clock.time += 1.0
        self.power.serve()
        closed: bool = self.power.truth()["closed"]
        return closed


@pytest.fixture
def host() -> Iterator[Host]:
    made = Host()
    yield made
    for port in made.power.ports.values():
        port.close()
    for fd in made.fds.values():
        os.close(fd)


def test_the_relay_is_open_at_first_and_follows_whole_orders(host: Host) -> None:
    assert host.supply == [False]
    assert not host.send(LCUS_ON[:3])
    assert host.send(LCUS_ON[3:])
    assert host.power.truth()["changed_at"] == 12.0
    assert host.send(b"\x00\xa0" + LCUS_ON)
    assert not host.send(LCUS_ON + LCUS_OFF)
    assert host.supply == [False, True, False]


def test_the_last_order_of_a_host_that_has_gone_counts(host: Host) -> None:
    assert host.send(LCUS_ON)
    os.write(host.fds[RELAY], LCUS_OFF)
    os.close(host.fds[RELAY])
    host.fds[RELAY] = os.open(os.devnull, os.O_RDONLY)
    host.power.serve()
    assert not host.power.truth()["closed"]


def test_a_welded_contact_stays_closed(host: Host) -> None:
    assert host.send(LCUS_ON)
    host.power.relay(stuck=True)
    assert host.send(LCUS_OFF)
    host.power.relay(stuck=False)
    assert not host.send(LCUS_OFF)


def test_a_pulled_relay_opens(host: Host) -> None:
    assert host.send(LCUS_ON)
    host.power.relay(plugged=False)
    assert host.supply == [False, True, False]


def test_the_button_sends_its_state_again_and_again(host: Host) -> None:
    def sent() -> bytes:
        host.clock.time += SENT
        host.power.serve()
        return os.read(host.fds[BUTTON], 16)

    assert sent() == b"0"
    host.power.button(pressed=True)
    assert sent() == b"1"
    host.power.button(pressed=False)
    assert sent() == b"0"
    host.power.button(plugged=False)
    assert sent() == b"", "a hang-up"


def test_a_bus_with_the_name_of_the_relay_is_refused(tmp_path: Path) -> None:
    from tests.support.small_robot_file import SMALL, read

    robot = read(tmp_path, SMALL + "power: {relay: {kind: rts, port: a}}\n")
    assert power_ports(robot, ["main"]) == ["relay"]
    assert power_ports(None, ["relay"]) == []
    with pytest.raises(InvalidInput, match="rename the bus"):
        power_ports(robot, ["relay"])
