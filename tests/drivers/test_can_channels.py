"""Channels against another end: ptys, virtual motors, python-can's slcan and its bus without a wire."""

import os
from collections.abc import Callable, Iterator
from math import inf

import can
import numpy as np
import pytest

from tests.support.can_channels_rig import Terminal
from tests.support.can_frames import cycle, messages_of, mixed, received_frames, same
from twind_drivers.bus import PortError
from twind_drivers.clock import FakeClock, MonotonicClock
from twind_drivers.ports import can_ports
from twind_drivers.ports.can_ports import CanPortName, open_channel, parse, present
from twind_drivers.ports.channel import CanErrorState
from twind_drivers.ports.frame import frames
from twind_drivers.ports.python_can_channel import PythonCanChannel
from twind_drivers.ports.serial_port import SerialTransport
from twind_drivers.ports.slcan_channel import SlcanChannel
from twind_drivers.ports.slcan_codec import encode
from twind_drivers.virtual.can.can_motor_physics import FirstOrderCanPhysics
from twind_drivers.virtual.can.node_spec import NodeSpec
from twind_drivers.virtual.can.virtual_can_bus import VirtualCanBus
from twind_drivers.virtual.serial_loopback import Loopback

OPENING = b"\r\rC\rS8\rO\r"
NOWHERE = "can-none"


@pytest.fixture
def terminal() -> Iterator[Terminal]:
    terminal = Terminal()
    yield terminal
    terminal.unplug()


# ------------------------------------------------------------------------------------- slcan on a pty


def test_a_serial_adapter_opens_by_its_name_and_transfers_both_ways(terminal: Terminal) -> None:
    channel = open_channel(f"can:slcan:{terminal.path}", 1_000_000)
    assert channel.name == terminal.path
    assert terminal.received(len(OPENING)) == OPENING
    channel.send(mixed(), 0.0)
    assert terminal.received(len(encode(mixed()))) == encode(mixed())
    os.write(terminal.master, encode(mixed()))
    assert received_frames(channel, 12).tobytes() == mixed().tobytes()
    assert terminal.received(2) == b"F\r"  # has it flags to tell?
    channel.close()
    assert terminal.received(4) == b"\r\rC\r"
    assert channel.fileno() == -1


def test_an_unplugged_adapter_is_lost_by_reading_and_by_writing_and_closes_quietly(
    terminal: Terminal,
) -> None:
    channel = open_channel(f"can:slcan:{terminal.path}", 1_000_000)
    terminal.unplug()
    clock = MonotonicClock()
    begin = clock.now()
    clock.wait([channel], begin + 60.0)
    assert clock.now() < begin + 30.0  # a hang-up wakes
    acts: list[Callable[[], object]] = [
        lambda: channel.receive(0.0),
        lambda: channel.send(cycle(1), 0.0),
        channel.purge,
    ]
    for act in acts:
        with pytest.raises(PortError, match="its program has ended") as lost:
            act()
        assert lost.value.lost
    channel.close()


# ------------------------------------------------------------------------------------- slcan in process


class Body:
    """Four virtual motors behind a serial adapter in this process, and our channel to them."""

    def __init__(self) -> None:
        self.clock = FakeClock()
        nodes = [NodeSpec(id=id, model="DM4340", feedback_id=0x10 + id) for id in range(1, 5)]
        self.bus = VirtualCanBus("arm", nodes, FirstOrderCanPhysics(np.zeros(4)))
        self.channel = SlcanChannel(Loopback(self.bus, self.clock), 1_000_000)

    def tick(self) -> list[int]:
        """10 ms: all are told to be limp, and who answers is given by id."""
        begin = self.clock.now()
        limp = np.frombuffer(bytes.fromhex("7FFF7FF0000007FF"), np.uint8)
        self.channel.send(frames(np.arange(1, 5), limp), begin)
        found = []
        while self.clock.now() < begin + 0.01:
            self.clock.wait([self.channel], begin + 0.01)
            found += self.channel.receive(self.clock.now())["id"].tolist()
        return sorted(found)


def test_a_virtual_adapter_in_process_answers_under_a_fake_clock() -> None:
    body = Body()
    assert [body.tick() for _ in range(50)] == [[0x11, 0x12, 0x13, 0x14]] * 50
    assert (body.channel.condition.line, body.channel.condition.refused) == (CanErrorState.ACTIVE, 0)
    body.channel.close()


def test_motors_without_power_are_a_line_that_is_off_and_come_back_when_they_answer() -> None:
    body = Body()
    body.tick()
    body.bus.faults.power(False)
    began = body.clock.now()
    while body.channel.condition.line is not CanErrorState.OFF:
        assert not body.tick()
        assert body.clock.now() < began + 1.0
    body.channel.purge()
    body.bus.faults.power(True)
    while not body.tick():
        assert body.clock.now() < began + 3.0
    assert body.channel.condition.line is CanErrorState.PASSIVE  # as its flags said while nobody was there
    ticks = [body.tick() for _ in range(30)]  # what waited while they started is answered first
    assert ticks[-1] == [0x11, 0x12, 0x13, 0x14]
    assert body.channel.condition.line is CanErrorState.ACTIVE


# ------------------------------------------------------------------------------------- python-can, virtual


@pytest.fixture
def pair(request: pytest.FixtureRequest) -> Iterator[tuple[PythonCanChannel, can.BusABC]]:
    name = request.node.name
    channel = open_channel(f"can:virtual:{name}", 1_000_000)
    assert isinstance(channel, PythonCanChannel)
    with can.Bus(name, interface="virtual", ignore_config=True) as other:
        yield channel, other
    channel.close()


def test_frames_of_every_kind_pass_to_python_can_and_back(
    pair: tuple[PythonCanChannel, can.BusABC],
) -> None:
    channel, other = pair
    channel.send(mixed(), 0.0)
    for wanted in messages_of(mixed()):
        message = other.recv(timeout=0)
        assert message is not None
        assert same(message, wanted)
    for message in messages_of(mixed()):
        other.send(message)
    assert channel.receive(0.0).tobytes() == mixed().tobytes()
    assert not len(channel.receive(0.0))
    assert (channel.condition.errors, channel.condition.refused) == (0, 0)


def test_a_frame_that_is_not_classic_is_counted_and_not_returned(
    pair: tuple[PythonCanChannel, can.BusABC],
) -> None:
    channel, other = pair
    other.send(can.Message(arbitration_id=1, is_fd=True, data=bytes(12), is_extended_id=False))
    short = can.Message(arbitration_id=2, data=b"\1\2", is_extended_id=False)
    short.dlc = 8  # as python-can's slcan gives a line that was cut
    other.send(short)
    other.send(can.Message(arbitration_id=3, data=b"\3", is_extended_id=False))
    assert channel.receive(0.0)["id"].tolist() == [3]
    assert channel.condition.errors == 2


def test_an_invalid_frame_is_not_sent_nor_are_those_before_it(
    pair: tuple[PythonCanChannel, can.BusABC],
) -> None:
    channel, other = pair
    wrong = cycle(3)
    wrong[2]["id"] = 0x800
    with pytest.raises(ValueError, match="00000800 with 8 bytes"):
        channel.send(wrong, 0.0)
    assert other.recv(timeout=0) is None


def test_a_bus_without_a_descriptor_wakes_both_clocks(pair: tuple[PythonCanChannel, can.BusABC]) -> None:
    channel, other = pair
    assert channel.fileno() == -1
    fake = FakeClock()
    fake.wait([channel], 0.5)
    assert fake.now() == 0.5  # nothing there: time goes on
    assert channel.arrival() == inf
    other.send(messages_of(cycle(1))[0])
    fake.wait([channel], 1.0)
    assert fake.now() == 0.5
    clock = MonotonicClock()
    begin = clock.now()
    clock.wait([channel], begin + 60.0)
    assert clock.now() < begin + 30.0
    assert channel.receive(0.5).tobytes() == cycle(1).tobytes()  # looking has not eaten it


def test_a_closed_channel_is_lost_and_wakes_its_waiter(
    pair: tuple[PythonCanChannel, can.BusABC],
) -> None:
    channel, _ = pair
    channel.close()
    channel.close()
    assert channel.arrival() == -inf
    for act in (lambda: channel.send(cycle(1), 0.0), lambda: channel.receive(0.0)):
        with pytest.raises(PortError, match="closed") as lost:
            act()
        assert lost.value.lost


def test_a_purged_channel_drops_old_frames_and_works(
    pair: tuple[PythonCanChannel, can.BusABC],
) -> None:
    channel, other = pair
    other.send(messages_of(cycle(1))[0])
    assert channel.arrival() == -inf
    channel.purge()
    assert not len(channel.receive(0.0))
    other.send(messages_of(cycle(1))[0])
    assert len(channel.receive(0.0)) == 1


# ------------------------------------------------------------------------------------- names of ports


@pytest.mark.parametrize(
    ("port", "parts"),
    [
        ("can:socketcan:can0", CanPortName("socketcan", "can0")),
        ("can:slcan:/dev/ttyACM0", CanPortName("slcan", "/dev/ttyACM0")),
        ("can:slcan:/dev/serial/by-path/pci-0:1:2", CanPortName("slcan", "/dev/serial/by-path/pci-0:1:2")),
        ("can:slcan:/dev/ttyUSB0@2000000", CanPortName("slcan", "/dev/ttyUSB0", 2_000_000)),
        ("can:udp_multicast:ff15:7079::1", CanPortName("udp_multicast", "ff15:7079::1")),
        ("can:virtual:a@b", CanPortName("virtual", "a@b")),
    ],
)
def test_a_port_name_gives_interface_and_channel(port: str, parts: CanPortName) -> None:
    assert can_ports.is_can(port)
    assert parse(port) == parts


@pytest.mark.parametrize(
    "port", ["can:", "can:can0", "can::can0", "can:slcan:", "/dev/ttyACM0", "", "CAN:socketcan:can0"]
)
def test_another_name_is_refused_with_the_form(port: str) -> None:
    with pytest.raises(ValueError, match="a CAN port is can:INTERFACE:CHANNEL, such as can:socketcan:can0"):
        parse(port)
    with pytest.raises(PortError, match="a CAN port is can:INTERFACE:CHANNEL"):
        open_channel(port, 1_000_000)


@pytest.mark.parametrize("rate", ["", "fast", "0", "-5", "²"])
def test_a_baud_rate_that_is_none_is_refused(rate: str) -> None:
    with pytest.raises(ValueError, match="after @ stands the adapter's baud rate"):
        parse(f"can:slcan:/dev/ttyUSB0@{rate}")


def test_a_connected_adapter_is_present(terminal: Terminal) -> None:
    assert present(f"can:slcan:{terminal.path}")
    assert not present("can:slcan:/dev/ttyACM99")
    assert present("can:socketcan:lo")  # the kernel has it; what it is, opening tells
    assert not present(f"can:socketcan:{NOWHERE}")
    assert present("can:pcan:PCAN_USBBUS1")  # nobody can say


def test_an_unusable_serial_port_reports_the_cause(terminal: Terminal) -> None:
    with pytest.raises(PortError, match="no such port"):
        open_channel("can:slcan:/dev/ttyACM99", 1_000_000)
    with pytest.raises(PortError, match="bitrate 123 is not a bitrate of slcan"):
        open_channel(f"can:slcan:{terminal.path}", 123)
    SerialTransport(terminal.path, 115_200).close()  # and the port is free again
