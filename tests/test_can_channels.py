"""Channels against another end: ptys, virtual motors, python-can's slcan and bus, a socket that fails."""

import errno
import os
import pty
import select
import socket
import struct
import termios
import tty
from collections.abc import Callable, Iterator
from math import inf
from pathlib import Path

import can
import numpy as np
import pytest
from can.interfaces.slcan import slcanBus
from can.interfaces.socketcan import socketcan

from twind_drivers.bus import PortError, PortFull
from twind_drivers.can import link, ports, python_can
from twind_drivers.can.channel import Channel, Line
from twind_drivers.can.frame import EXTENDED, FRAME, REMOTE, Frames, frames, payload
from twind_drivers.can.ports import CanPort, open_channel, parse, present
from twind_drivers.can.python_can import PythonCanChannel
from twind_drivers.can.slcan import SlcanChannel
from twind_drivers.can.slcan_lines import encode
from twind_drivers.clock import FakeClock, MonotonicClock
from twind_drivers.dynamixel.serial_port import SerialTransport
from twind_drivers.virtual.can.bus import VirtualCanBus
from twind_drivers.virtual.can.muscles import FirstOrderCan
from twind_drivers.virtual.can.spec import NodeSpec
from twind_drivers.virtual.loopback import Loopback

OPENING = b"\r\rC\rS8\rO\r"
NOWHERE = "can-none"  # an interface that no machine has: 8 characters, so the kernel looks for it


def cycle(count: int) -> Frames:
    data = np.random.default_rng(count).integers(0, 256, (count, 8), dtype=np.uint8)
    return frames(np.arange(1, count + 1), data)


def mixed() -> Frames:
    """One frame of each kind, and every size."""
    rows = np.zeros(12, FRAME)
    for size in range(9):
        rows[size]["id"], rows[size]["size"] = 0x100 + size, size
        rows[size]["data"][:size] = range(0xF0, 0xF0 + size)
    rows[9]["id"], rows[9]["size"] = 0x1ABCDEF0 | EXTENDED, 8
    rows[10]["id"], rows[10]["size"] = 0x123 | REMOTE, 4
    rows[11]["id"] = 0x7F | EXTENDED | REMOTE
    return rows


def messages_of(rows: Frames) -> list[can.Message]:
    return [
        can.Message(
            arbitration_id=int(row["id"]) & 0x1FFFFFFF,
            is_extended_id=bool(int(row["id"]) & EXTENDED),
            is_remote_frame=bool(int(row["id"]) & REMOTE),
            dlc=int(row["size"]),
            data=None if int(row["id"]) & REMOTE else payload(row),
        )
        for row in rows
    ]


def same(message: can.Message, wanted: can.Message) -> bool:
    return message.equals(wanted, timestamp_delta=None, check_channel=False, check_direction=False)


def heard(channel: Channel, count: int) -> Frames:
    """What a channel hears until `count` frames are there, in real time."""
    clock, parts, total = MonotonicClock(), [cycle(0)], 0
    deadline = clock.now() + 5.0
    while total < count and clock.now() < deadline:
        clock.wait([channel], deadline)
        parts.append(channel.receive(clock.now()))
        total += len(parts[-1])
    return np.concatenate(parts)


class Terminal:
    """A pty; whoever holds `master` is the adapter."""

    def __init__(self) -> None:
        self.master, self.slave = pty.openpty()
        tty.setraw(self.slave, termios.TCSANOW)
        self.path = os.ttyname(self.slave)

    def unplug(self) -> None:
        for fd in (self.master, self.slave):
            if fd >= 0:
                os.close(fd)
        self.master = self.slave = -1

    def told(self, count: int) -> bytes:
        """`count` bytes that the adapter got."""
        got = b""
        while len(got) < count and select.select([self.master], [], [], 2.0)[0]:
            got += os.read(self.master, count - len(got))
        return got


@pytest.fixture
def terminal() -> Iterator[Terminal]:
    terminal = Terminal()
    yield terminal
    terminal.unplug()


# ------------------------------------------------------------------------------------- slcan on a pty


def test_a_serial_adapter_opens_by_its_name_and_speaks_both_ways(terminal: Terminal) -> None:
    channel = open_channel(f"can:slcan:{terminal.path}", 1_000_000)
    assert channel.name == terminal.path
    assert terminal.told(len(OPENING)) == OPENING
    channel.send(mixed(), 0.0)
    assert terminal.told(len(encode(mixed()))) == encode(mixed())
    os.write(terminal.master, encode(mixed()))
    assert heard(channel, 12).tobytes() == mixed().tobytes()
    assert terminal.told(2) == b"F\r"  # has it flags to tell?
    channel.close()
    assert terminal.told(4) == b"\r\rC\r"
    assert channel.fileno() == -1


@pytest.mark.parametrize("size", [1, 7, 64])
def test_frames_that_come_in_pieces_come_whole(terminal: Terminal, size: int) -> None:
    channel = open_channel(f"can:slcan:{terminal.path}", 1_000_000)
    text, parts = encode(cycle(24)), []
    for begin in range(0, len(text), size):
        os.write(terminal.master, text[begin : begin + size])
        if begin % (3 * size) == 0:
            parts.append(channel.receive(0.0))
    parts.append(heard(channel, 24 - sum(map(len, parts))))
    assert np.concatenate(parts).tobytes() == cycle(24).tobytes()
    channel.close()


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
        with pytest.raises(PortError, match="unplugged") as lost:
            act()
        assert lost.value.lost
    channel.close()


def test_an_adapter_that_reads_nothing_fills_up_and_is_lost_after_a_second(terminal: Terminal) -> None:
    channel = open_channel(f"can:slcan:{terminal.path}", 1_000_000)
    full = []
    for tick in range(1000):
        try:
            channel.send(cycle(24), tick * 0.01)
        except PortError as error:
            full.append((tick, error))
            if error.lost:
                break
    first, last = full[0], full[-1]
    assert isinstance(first[1], PortFull)
    assert last[1].lost
    assert 100 <= last[0] - first[0] <= 150
    channel.close()


@pytest.mark.realtime
def test_our_slcan_and_python_cans_understand_each_other_on_the_two_ends_of_one_wire() -> None:
    ours, theirs = Terminal(), Terminal()
    channel = open_channel(f"can:slcan:{ours.path}", 1_000_000)
    bus = slcanBus(theirs.path, bitrate=1_000_000, sleep_after_open=0.0)
    try:
        ours.told(len(OPENING))
        assert theirs.told(10) == b"C\rS8\r\rO\rO\r"
        for message in messages_of(mixed()):
            bus.send(message)
        os.write(ours.master, theirs.told(len(encode(mixed()))))
        assert heard(channel, 12).tobytes() == mixed().tobytes()
        channel.send(mixed(), 0.0)
        os.write(theirs.master, ours.told(len(b"F\r" + encode(mixed()))))  # the question harms nobody
        for wanted in messages_of(mixed()):
            message = bus.recv(timeout=2.0)
            assert message is not None
            assert same(message, wanted)
        assert channel.condition.errors == 0
    finally:
        bus.shutdown()
        channel.close()
        ours.unplug()
        theirs.unplug()


# ------------------------------------------------------------------------------------- slcan in process


class Body:
    """Four virtual motors behind a serial adapter in this process, and our channel to them."""

    def __init__(self) -> None:
        self.clock = FakeClock()
        nodes = [NodeSpec(id=id, model="DM4340", feedback_id=0x10 + id) for id in range(1, 5)]
        self.bus = VirtualCanBus("arm", nodes, FirstOrderCan(np.zeros(4)))
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
    assert (body.channel.condition.line, body.channel.condition.refused) == (Line.ACTIVE, 0)
    body.channel.close()


def test_motors_without_power_are_a_line_that_is_off_and_come_back_when_they_answer() -> None:
    body = Body()
    body.tick()
    body.bus.faults.power(False)
    began = body.clock.now()
    while body.channel.condition.line is not Line.OFF:
        assert not body.tick()
        assert body.clock.now() < began + 1.0
    body.channel.purge()
    body.bus.faults.power(True)
    while not body.tick():
        assert body.clock.now() < began + 3.0
    assert body.channel.condition.line is Line.PASSIVE  # as its flags said while nobody was there
    ticks = [body.tick() for _ in range(30)]  # what waited while they started is answered first
    assert ticks[-1] == [0x11, 0x12, 0x13, 0x14]
    assert body.channel.condition.line is Line.ACTIVE


def test_a_virtual_adapter_that_is_pulled_out_is_lost() -> None:
    body = Body()
    body.tick()
    body.bus.faults.unplug()
    with pytest.raises(PortError, match="unplugged") as lost:
        body.tick()
    assert lost.value.lost
    body.channel.close()


def test_a_virtual_adapter_that_hangs_is_lost_after_a_second() -> None:
    body = Body()
    body.tick()
    body.bus.faults.stall()
    began, lost = body.clock.now(), False
    while not lost and body.clock.now() < began + 3.0:
        try:
            body.tick()
        except PortError as error:
            lost = error.lost
            body.clock.sleep_until(body.clock.now() + 0.01)
    assert lost
    assert 1.0 <= body.clock.now() - began <= 1.2


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


def test_what_is_no_classic_frame_is_counted_and_not_given(
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


def test_what_is_no_frame_is_not_sent_and_neither_are_those_before_it(
    pair: tuple[PythonCanChannel, can.BusABC],
) -> None:
    channel, other = pair
    wrong = cycle(3)
    wrong[2]["id"] = 0x800
    with pytest.raises(ValueError, match="00000800 with 8 bytes"):
        channel.send(wrong, 0.0)
    assert other.recv(timeout=0) is None


def test_a_bus_without_descriptor_wakes_both_clocks(pair: tuple[PythonCanChannel, can.BusABC]) -> None:
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


def test_a_closed_channel_is_lost_and_wakes_whoever_waits(
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


def test_a_purged_channel_hears_nothing_of_before_and_works(
    pair: tuple[PythonCanChannel, can.BusABC],
) -> None:
    channel, other = pair
    other.send(messages_of(cycle(1))[0])
    assert channel.arrival() == -inf
    channel.purge()
    assert not len(channel.receive(0.0))
    other.send(messages_of(cycle(1))[0])
    assert len(channel.receive(0.0)) == 1


# ------------------------------------------------------------------------------------- python-can, socketcan
# The kernel's own CAN is not to be had everywhere, so here its socket alone is another: the code path of
# python-can's socketcan and ours are the real ones.


class Wire:
    """What every socket of one test does."""

    def __init__(self) -> None:
        self.sent: list[bytes] = []
        self.refuses = 0  # errno of every send
        self.fails = 0  # errno of every reading
        self.gone = 0  # errno of every bind
        self.room = 10**9  # frames until the queue is full
        self.unwritable = False
        self.sockets: list[CanSocket] = []

    def socket(self) -> "CanSocket":
        self.sockets.append(CanSocket(self))
        return self.sockets[-1]

    def say(self, id: int, data: bytes) -> None:
        """A frame from the wire, or of the controller."""
        record = struct.pack("<IB3x8s", id, len(data), data)
        self.sockets[-1].theirs.send(record)


class CanSocket:
    """As a raw CAN socket behaves, over a pair of local ones."""

    def __init__(self, wire: Wire) -> None:
        self.wire = wire
        self.ours, self.theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)

    def setsockopt(self, *arguments: object) -> None:
        return

    def bind(self, address: tuple[str]) -> None:
        if self.wire.gone:
            self.close()
            raise OSError(self.wire.gone, os.strerror(self.wire.gone))

    def fileno(self) -> int:
        return self.ours.fileno()

    def send(self, data: bytes) -> int:
        if self.wire.refuses:
            raise OSError(self.wire.refuses, os.strerror(self.wire.refuses))
        if len(self.wire.sent) >= self.wire.room:
            raise OSError(errno.ENOBUFS, os.strerror(errno.ENOBUFS))
        self.wire.sent.append(data)
        return len(data)

    def recvmsg(self, size: int, room: int) -> tuple[bytes, list[tuple[int, int, bytes]], int, object]:
        if self.wire.fails:
            raise OSError(self.wire.fails, os.strerror(self.wire.fails))
        stamp = (socket.SOL_SOCKET, 35, struct.pack("@ll", 0, 0))  # SO_TIMESTAMPNS
        return self.ours.recv(size), [stamp], 0, (NOWHERE,)

    def close(self) -> None:
        self.ours.close()
        self.theirs.close()


@pytest.fixture
def wire(monkeypatch: pytest.MonkeyPatch) -> Iterator[Wire]:
    wire = Wire()
    monkeypatch.setattr(socketcan, "create_socket", wire.socket)
    yield wire
    for each in wire.sockets:
        each.close()


def opened() -> PythonCanChannel:
    channel = open_channel(f"can:socketcan:{NOWHERE}", 1_000_000)
    assert isinstance(channel, PythonCanChannel)
    return channel


def test_frames_cross_a_raw_socket_as_the_kernel_lays_them_out(wire: Wire) -> None:
    channel = opened()
    assert channel.fileno() == wire.sockets[0].fileno()
    channel.send(mixed(), 0.0)
    assert b"".join(each[:5] + each[8:] for each in wire.sent) == b"".join(
        row.tobytes()[:5] + row.tobytes()[8:] for row in mixed()
    )
    for row in mixed():
        wire.say(int(row["id"]), payload(row) if not int(row["id"]) & REMOTE else bytes(int(row["size"])))
    assert channel.receive(0.1).tobytes() == mixed().tobytes()
    channel.close()


def test_a_full_queue_is_congestion_for_a_second_then_the_bus_is_dead_and_emptied(wire: Wire) -> None:
    channel = opened()
    wire.refuses = errno.ENOBUFS
    for tick in range(100):
        with pytest.raises(PortFull, match="full after 0 of 24 frames") as full:
            channel.send(cycle(24), tick * 0.01)
        assert not full.value.lost
        assert channel.condition.line is (Line.OFF if tick >= 10 else Line.ACTIVE)
    assert channel.condition.refused == 2400
    with pytest.raises(PortError, match=r"taken nothing for 1\.0 s.*powered") as lost:
        channel.send(cycle(24), 1.001)
    assert lost.value.lost
    assert len(wire.sockets) == 2  # closed and opened again
    assert wire.sockets[0].ours.fileno() == -1
    assert "could not be taken down and up" in channel.warning  # nothing of that name: its queue is not ours
    assert "ip link set can-none down" in channel.warning
    channel.close()


def test_a_link_goes_down_and_up_only_where_frames_may_wait_and_once_a_second(
    wire: Wire, monkeypatch: pytest.MonkeyPatch
) -> None:
    downs: list[str] = []
    monkeypatch.setattr(python_can, "restart", lambda name: downs.append(name) or "")
    channel = opened()
    channel.purge()
    wire.say(1, b"")
    channel.receive(0.0)
    channel.send(cycle(4), 0.01)
    channel.purge()  # somebody was there when it was sent
    assert downs == []
    channel.send(cycle(4), 0.2)  # nobody has been heard for a while
    channel.purge()
    assert downs == [NOWHERE]
    channel.send(cycle(4), 0.3)
    channel.purge()
    assert downs == [NOWHERE]  # it takes long
    channel.close()
    assert downs == [NOWHERE] * 2  # but nothing is left behind
    channel = opened()
    channel.send(cycle(4), 5.0)
    wire.say(1, b"")
    channel.receive(5.01)  # somebody is there: it has left
    channel.close()
    assert downs == [NOWHERE] * 2


def test_a_queue_that_drains_in_time_is_never_lost(wire: Wire) -> None:
    channel, dropped = opened(), 0
    for tick in range(500):
        wire.refuses = errno.ENOBUFS if tick % 50 < 40 else 0
        try:
            channel.send(cycle(24), tick * 0.01)
        except PortFull:
            dropped += 1
    assert dropped == 400
    assert channel.condition.refused == 400 * 24
    assert channel.condition.line is Line.ACTIVE
    channel.close()


def test_a_queue_that_takes_a_part_of_a_cycle_is_no_dead_one(wire: Wire) -> None:
    channel = opened()
    for tick in range(300):
        wire.room = len(wire.sent) + 3
        with pytest.raises(PortFull, match="full after 3 of 24"):
            channel.send(cycle(24), tick * 0.01)
    assert channel.condition.refused == 300 * 21
    channel.close()


def test_full_without_a_number_is_full_as_well(wire: Wire, monkeypatch: pytest.MonkeyPatch) -> None:
    channel = opened()
    never = lambda reading, writing, failing, timeout: (reading, [], [])  # noqa: E731 - a socket nobody may write
    with monkeypatch.context() as patch:
        patch.setattr(socketcan.select, "select", never)
        with pytest.raises(PortFull):
            channel.send(cycle(1), 0.0)
    channel.send(cycle(1), 0.01)
    assert len(wire.sent) == 1
    channel.close()


GONE = [errno.ENODEV, errno.ENXIO, errno.ENETDOWN, errno.ENETUNREACH, errno.EBADF]


@pytest.mark.parametrize("number", GONE)
def test_an_interface_that_goes_is_lost_at_once_by_either_way(wire: Wire, number: int) -> None:
    channel = opened()
    wire.refuses = number
    with pytest.raises(PortError, match=r"send failed.*interface down, or adapter unplugged") as lost:
        channel.send(cycle(1), 0.0)
    assert lost.value.lost
    wire.say(1, b"")
    wire.fails = number
    with pytest.raises(PortError, match=r"receive failed.*interface down, or adapter unplugged") as lost:
        channel.receive(0.0)
    assert lost.value.lost
    channel.close()


def test_a_socket_that_was_closed_under_us_is_lost(wire: Wire) -> None:
    channel = opened()
    wire.sockets[0].close()
    assert channel.arrival() == -inf
    with pytest.raises(PortError) as lost:
        channel.receive(0.0)
    assert lost.value.lost
    with pytest.raises(PortError) as lost:
        channel.send(cycle(1), 0.0)
    assert lost.value.lost
    channel.close()


ERROR_FLAG = 0x20000000


@pytest.mark.parametrize(
    ("id", "data", "line"),
    [
        (0x004, {1: 0x10}, Line.PASSIVE),
        (0x004, {1: 0x20}, Line.PASSIVE),
        (0x004, {1: 0x3C}, Line.PASSIVE),
        (0x004, {1: 0x08}, Line.ACTIVE),  # the warning level alone
        (0x004, {1: 0x01}, Line.ACTIVE),  # an overflow says nothing
        (0x040, {}, Line.OFF),
        (0x044, {1: 0x20}, Line.OFF),
        (0x080, {}, Line.ACTIVE),
    ],
)
def test_error_frames_are_the_condition_and_never_data(
    wire: Wire, id: int, data: dict[int, int], line: Line
) -> None:
    channel = opened()
    wire.say(ERROR_FLAG | id, bytes(data.get(place, 0) for place in range(8)))
    wire.say(0x11, b"\1")
    assert channel.receive(0.0)["id"].tolist() == [0x11]
    assert (channel.condition.line, channel.condition.errors) == (line, 1)
    channel.close()


@pytest.mark.parametrize(("id", "place", "bits"), [(0x100, 0, 0), (0x004, 1, 0x40), (0x008, 2, 0x40)])
def test_a_controller_that_is_back_is_told(wire: Wire, id: int, place: int, bits: int) -> None:
    channel = opened()
    wire.say(ERROR_FLAG | 0x040, bytes(8))
    channel.receive(0.0)
    assert channel.condition.line is Line.OFF
    wire.say(0x11, b"\1")  # a frame that was taken before says nothing of a controller that has left
    channel.receive(0.0)
    assert channel.condition.line is Line.OFF
    wire.say(ERROR_FLAG | id, bytes(bits if each == place else 0 for each in range(8)))
    channel.receive(0.0)
    assert channel.condition.line is Line.ACTIVE
    channel.close()


def test_an_interface_that_is_not_there_is_said_with_the_remedy(wire: Wire) -> None:
    wire.gone = errno.ENODEV
    with pytest.raises(PortError, match=r"no such CAN interface.*ip link set can-none up type can") as absent:
        opened()
    assert not absent.value.lost


def test_a_bus_that_does_not_come_back_from_a_purge_is_lost(wire: Wire) -> None:
    channel = opened()
    wire.gone = errno.ENODEV
    with pytest.raises(PortError, match="no such CAN interface") as lost:
        channel.purge()
    assert lost.value.lost
    with pytest.raises(PortError, match="closed"):
        channel.send(cycle(1), 0.0)


def test_a_kernel_without_can_is_named() -> None:
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError as error:
        assert error.errno == errno.EAFNOSUPPORT  # noqa: PT017 - what this machine says decides
        with pytest.raises(PortError, match="this kernel has no CAN; `sudo modprobe can_raw`"):
            opened()
    else:
        pytest.skip("this kernel has CAN")


def test_a_real_interface_passes_frames_between_two_sockets() -> None:
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError as error:
        pytest.skip(f"no AF_CAN here: {error.strerror}")
    if not link.present("vcan0"):
        pytest.skip("no vcan0 here")
    one, other = (open_channel("can:socketcan:vcan0", 1_000_000) for _ in range(2))
    one.send(mixed(), 0.0)
    assert heard(other, 12).tobytes() == mixed().tobytes()
    one.close()
    other.close()


def test_an_interface_that_python_can_does_not_know_is_named() -> None:
    with pytest.raises(PortError, match="python-can cannot drive 'telepathy'"):
        open_channel("can:telepathy:x", 1_000_000)


# ------------------------------------------------------------------------------------- names of ports


@pytest.mark.parametrize(
    ("port", "parts"),
    [
        ("can:socketcan:can0", CanPort("socketcan", "can0")),
        ("can:slcan:/dev/ttyACM0", CanPort("slcan", "/dev/ttyACM0")),
        ("can:slcan:/dev/serial/by-path/pci-0:1:2", CanPort("slcan", "/dev/serial/by-path/pci-0:1:2")),
        ("can:slcan:/dev/ttyUSB0@2000000", CanPort("slcan", "/dev/ttyUSB0", 2_000_000)),
        ("can:udp_multicast:ff15:7079::1", CanPort("udp_multicast", "ff15:7079::1")),
        ("can:virtual:a@b", CanPort("virtual", "a@b")),
    ],
)
def test_a_ports_name_says_interface_and_channel(port: str, parts: CanPort) -> None:
    assert ports.is_can(port)
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


def test_what_is_plugged_in_is_present(terminal: Terminal) -> None:
    assert present(f"can:slcan:{terminal.path}")
    assert not present("can:slcan:/dev/ttyACM99")
    assert present("can:socketcan:lo")  # the kernel has it; what it is, opening tells
    assert not present(f"can:socketcan:{NOWHERE}")
    assert present("can:pcan:PCAN_USBBUS1")  # nobody can say


def test_a_serial_port_that_cannot_be_had_says_why(terminal: Terminal) -> None:
    with pytest.raises(PortError, match="no such port"):
        open_channel("can:slcan:/dev/ttyACM99", 1_000_000)
    with pytest.raises(PortError, match="bitrate 123 is not one that slcan knows"):
        open_channel(f"can:slcan:{terminal.path}", 123)
    SerialTransport(terminal.path, 115_200).close()  # and the port is free again


# ------------------------------------------------------------------------------------- the kernel's interface


def test_a_long_queue_is_told_with_the_remedy(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(link, "INTERFACES", tmp_path)
    for name, length, kind in (("can0", 1000, 280), ("can1", 10, 280), ("eth0", 1000, 1)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "tx_queue_len").write_text(f"{length}\n")
        (tmp_path / name / "type").write_text(f"{kind}\n")
    assert "1000 frames" in link.long_queue("can0")
    assert "ip link set can0 txqueuelen 48" in link.long_queue("can0")
    assert link.long_queue("can1") == link.long_queue(NOWHERE) == ""
    assert link.interfaces() == ["can0", "can1"]


APART = """
import ctypes, os, sys
if ctypes.CDLL(None, use_errno=True).unshare(0x10000000 | 0x40000000):  # a user and a network of its own
    print("denied"); sys.exit()
from twind_drivers.can.link import restart
import fcntl, socket
from twind_drivers.can.link import FLAGS, REQUEST
def up():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        return REQUEST.unpack(fcntl.ioctl(asking, FLAGS, REQUEST.pack(b"lo", 0)))[1] & 1
before = up(); said = restart("lo"); print(before, repr(said), up(), repr(restart("none")))
"""


@pytest.mark.realtime
def test_an_interface_goes_down_and_up_where_it_is_permitted() -> None:
    """In a network of its own: `lo` starts there down."""
    import subprocess
    import sys

    done = subprocess.run([sys.executable, "-c", APART], capture_output=True, text=True, check=True)
    if done.stdout.strip() == "denied":
        pytest.skip("no network of our own to be had here")
    before, said, after, *rest = done.stdout.split(" ", 3)
    assert (before, said, after) == ("0", "''", "1")
    assert "No such device" in rest[0]
