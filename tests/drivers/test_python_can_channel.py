"""The kernel's CAN by python-can: full queues by how long, lost interfaces, error frames, the link itself."""

import errno
import os
import socket
import struct
from collections.abc import Iterator
from math import inf
from pathlib import Path

import can
import pytest
from can.interfaces.socketcan import socketcan

from tests.support.can_frames import cycle, mixed
from tests.support.driver_rig import is_output_full
from tests.support.python_can_channel_rig import NOWHERE, Wire, opened
from twind_drivers.bus import PortError
from twind_drivers.ports import can_interface_control, can_interface_lock, python_can_channel
from twind_drivers.ports.can_interface_lock import owners
from twind_drivers.ports.can_ports import open_channel
from twind_drivers.ports.channel import CanErrorState
from twind_drivers.ports.frame import REMOTE, payload

# The kernel's own CAN is not to be had everywhere, so here its socket alone is another: the code path of
# python-can's socketcan and ours are the real ones.


@pytest.fixture
def wire(monkeypatch: pytest.MonkeyPatch) -> Iterator[Wire]:
    wire = Wire()
    monkeypatch.setattr(socketcan, "create_socket", wire.socket)
    yield wire
    for each in wire.sockets:
        each.close()


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


def test_a_queue_full_for_a_second_is_a_dead_bus_and_is_emptied(wire: Wire) -> None:
    channel = opened()
    wire.refuses = errno.ENOBUFS
    for tick in range(100):
        with pytest.raises(PortError, match="full after 0 of 24 frames", check=is_output_full):
            channel.send(cycle(24), tick * 0.01)
        assert channel.condition.line is (CanErrorState.OFF if tick >= 10 else CanErrorState.ACTIVE)
    assert channel.condition.refused == 2400
    with pytest.raises(PortError) as lost:
        channel.send(cycle(24), 1.001)
    assert lost.value.lost
    assert len(wire.sockets) == 2  # closed and opened again
    assert wire.sockets[0].ours.fileno() == -1
    assert "could not be taken down and up" in channel.warning  # nothing of that name: its queue is not ours
    assert f"ip link set {NOWHERE} down" in channel.warning
    channel.close()


def test_a_link_goes_down_and_up_only_where_frames_may_wait_and_once_a_second(
    wire: Wire, monkeypatch: pytest.MonkeyPatch
) -> None:
    downs: list[str] = []
    monkeypatch.setattr(python_can_channel, "restart", lambda name: downs.append(name) or "")
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


class Owner:
    """Somebody who can write."""


def test_a_read_only_channel_never_restarts_the_link(wire: Wire, monkeypatch: pytest.MonkeyPatch) -> None:
    downs: list[str] = []
    monkeypatch.setattr(python_can_channel, "restart", lambda name: downs.append(name) or "")
    channel = opened(drives=False)
    owner = Owner()
    for now in (0.2, 2.0):
        channel.send(cycle(4), now)
        channel.purge()
    assert downs == []
    channel.drive(owner)
    channel.send(cycle(4), 4.0)
    channel.purge()
    assert downs == [NOWHERE]
    del owner  # the mode is mirror again
    channel.send(cycle(4), 6.0)
    channel.purge()
    channel.close()
    assert downs == [NOWHERE]


def test_a_warning_remains_after_the_queue_was_emptied(wire: Wire) -> None:
    channel = opened()
    channel.warning = "ids [3]: no watchdog"
    for now in (0.2, 2.0):
        channel.send(cycle(4), now)
        channel.purge()
        assert channel.warning.endswith("; ids [3]: no watchdog")
        assert channel.warning.count("could not be taken down and up") == 1
    channel.close()


def test_a_queue_that_drains_in_time_is_never_lost(wire: Wire) -> None:
    channel = opened()
    dropped = 0
    for tick in range(500):
        wire.refuses = errno.ENOBUFS if tick % 50 < 40 else 0
        try:
            channel.send(cycle(24), tick * 0.01)
        except PortError as error:
            dropped += is_output_full(error)
    assert dropped == 400
    assert channel.condition.refused == 400 * 24
    assert channel.condition.line is CanErrorState.ACTIVE
    channel.close()


def test_a_queue_that_takes_part_of_a_cycle_is_not_dead(wire: Wire) -> None:
    channel = opened()
    for tick in range(300):
        wire.room = len(wire.sent) + 3
        with pytest.raises(PortError, match="full after 3 of 24", check=is_output_full):
            channel.send(cycle(24), tick * 0.01)
    assert channel.condition.refused == 300 * 21
    channel.close()


def test_full_without_a_number_is_full_as_well(wire: Wire, monkeypatch: pytest.MonkeyPatch) -> None:
    channel = opened()
    never = lambda reading, writing, failing, timeout: (reading, [], [])  # noqa: E731 - a socket nobody may write
    with monkeypatch.context() as patch:
        patch.setattr(socketcan.select, "select", never)
        with pytest.raises(PortError, check=is_output_full):
            channel.send(cycle(1), 0.0)
    channel.send(cycle(1), 0.01)
    assert len(wire.sent) == 1
    channel.close()


GONE = [errno.ENODEV, errno.ENXIO, errno.ENETDOWN, errno.ENETUNREACH, errno.EBADF]


@pytest.mark.parametrize("number", GONE)
def test_an_interface_that_goes_is_lost_at_once_by_either_way(wire: Wire, number: int) -> None:
    channel = opened()
    wire.refuses = number
    with pytest.raises(PortError) as lost:
        channel.send(cycle(1), 0.0)
    assert lost.value.lost
    wire.say(1, b"")
    wire.fails = number
    with pytest.raises(PortError) as lost:
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
        (0x004, {1: 0x10}, CanErrorState.PASSIVE),
        (0x004, {1: 0x20}, CanErrorState.PASSIVE),
        (0x004, {1: 0x3C}, CanErrorState.PASSIVE),
        (0x004, {1: 0x08}, CanErrorState.ACTIVE),  # the warning level alone
        (0x004, {1: 0x01}, CanErrorState.ACTIVE),  # an overflow says nothing
        (0x040, {}, CanErrorState.OFF),
        (0x044, {1: 0x20}, CanErrorState.OFF),
        (0x080, {}, CanErrorState.ACTIVE),
    ],
)
def test_error_frames_are_the_condition_and_never_data(
    wire: Wire, id: int, data: dict[int, int], line: CanErrorState
) -> None:
    channel = opened()
    wire.say(ERROR_FLAG | id, bytes(data.get(place, 0) for place in range(8)))
    wire.say(0x11, b"\1")
    assert channel.receive(0.0)["id"].tolist() == [0x11]
    assert (channel.condition.line, channel.condition.errors) == (line, 1)
    channel.close()


@pytest.mark.parametrize(("id", "place", "bits"), [(0x100, 0, 0), (0x004, 1, 0x40), (0x008, 2, 0x40)])
def test_a_recovered_controller_is_reported(wire: Wire, id: int, place: int, bits: int) -> None:
    channel = opened()
    wire.say(ERROR_FLAG | 0x040, bytes(8))
    channel.receive(0.0)
    assert channel.condition.line is CanErrorState.OFF
    wire.say(0x11, b"\1")  # a frame that was taken before says nothing of a controller that has left
    channel.receive(0.0)
    assert channel.condition.line is CanErrorState.OFF
    wire.say(ERROR_FLAG | id, bytes(bits if each == place else 0 for each in range(8)))
    channel.receive(0.0)
    assert channel.condition.line is CanErrorState.ACTIVE
    channel.close()


@pytest.mark.parametrize("failure", ["", "could not be taken down and up"])
def test_a_controller_whose_link_went_down_and_up_is_on_the_wire_again(
    wire: Wire, monkeypatch: pytest.MonkeyPatch, failure: str
) -> None:
    """The kernel sends no error frame then: the bus stayed off, and barred arming, until the daemon ended."""
    monkeypatch.setattr(python_can_channel, "restart", lambda name: failure)
    channel = opened()
    wire.say(ERROR_FLAG | 0x040, bytes(8))
    channel.receive(0.0)
    channel.send(cycle(1), 0.2)
    channel.purge()
    off = CanErrorState.OFF if failure else CanErrorState.ACTIVE
    assert channel.condition.line is off
    wire.say(ERROR_FLAG | 0x040, bytes(8))  # the wire is still shorted
    channel.receive(0.3)
    assert channel.condition.line is CanErrorState.OFF
    channel.close()


def test_a_missing_interface_is_reported_with_the_remedy(wire: Wire) -> None:
    wire.gone = errno.ENODEV
    with pytest.raises(
        PortError, match=rf"no such CAN interface.*ip link set {NOWHERE} up type can"
    ) as absent:
        opened()
    assert not absent.value.lost


def test_a_bus_that_does_not_come_back_from_a_purge_is_lost(wire: Wire) -> None:
    channel = opened()
    wire.gone = errno.ENODEV
    with pytest.raises(PortError) as lost:
        channel.purge()
    assert lost.value.lost
    with pytest.raises(PortError, match="closed"):
        channel.send(cycle(1), 0.0)
    channel.close()


def test_an_interface_has_one_owner_until_it_is_closed(wire: Wire) -> None:
    first = opened()
    with pytest.raises(
        PortError, match=rf"{NOWHERE}: in use by pid {os.getpid()} \(.+\); stop it first"
    ) as taken:
        opened()
    assert not taken.value.lost
    assert len(wire.sockets) == 1  # who may not have it does not listen to it either
    first.purge()
    with pytest.raises(PortError):
        opened()
    first.close()
    first.close()
    opened().close()


def test_a_loop_that_opens_a_taken_interface_again_and_again_looks_into_no_other_process(
    wire: Wire, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = opened()
    monkeypatch.setattr(can_interface_lock, "owners", lambda interface: pytest.fail("searched"))
    with pytest.raises(PortError, match=r"in use by another process \(`ss -xap \| grep twind-can-`\)"):
        open_channel(f"can:socketcan:{NOWHERE}", 1_000_000, by_signal=True)
    first.close()


def test_an_interface_that_cannot_be_opened_has_no_owner(wire: Wire) -> None:
    wire.gone = errno.ENODEV
    with pytest.raises(PortError, match="no such CAN interface"):
        opened()
    assert list(owners(NOWHERE)) == []
    wire.gone = 0
    opened().close()


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
    if not can_interface_control.present("vcan0"):
        pytest.skip("no vcan0 here")
    with can.Bus("vcan0", interface="socketcan") as other:
        one = open_channel("can:socketcan:vcan0", 1_000_000)
        one.send(mixed(), 0.0)
        told = [other.recv(timeout=1.0) for _ in range(len(mixed()))]
        assert [None if each is None else each.dlc for each in told] == mixed()["size"].tolist()
        one.close()


def test_an_interface_unknown_to_python_can_is_named() -> None:
    with pytest.raises(PortError, match="python-can cannot drive 'telepathy'"):
        open_channel("can:telepathy:x", 1_000_000)


# ------------------------------------------------------------------------------------- the kernel's interface


def test_a_long_transmit_queue_is_reported_with_the_remedy(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(can_interface_control, "INTERFACES", tmp_path)
    for name, length, kind in (("can0", 1000, 280), ("can1", 10, 280), ("eth0", 1000, 1)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "tx_queue_len").write_text(f"{length}\n")
        (tmp_path / name / "type").write_text(f"{kind}\n")
    assert "1000 frames" in can_interface_control.long_queue("can0")
    assert "ip link set can0 txqueuelen 48" in can_interface_control.long_queue("can0")
    assert can_interface_control.long_queue("can1") == can_interface_control.long_queue(NOWHERE) == ""
    assert can_interface_control.interfaces() == ["can0", "can1"]


@pytest.mark.parametrize("error", [RuntimeError("no device"), struct.error("short"), AttributeError("None")])
def test_any_back_end_exception_is_a_lost_port_and_close_is_silent(
    wire: Wire, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    """python-can hands on what a vendor's library raises: that ends a bus, not the daemon."""

    def fails(*_: object, **__: object) -> None:
        raise error

    channel = opened()
    for name in ("send", "recv", "shutdown"):
        monkeypatch.setattr(socketcan.SocketcanBus, name, fails)
    with pytest.raises(PortError) as lost:
        channel.send(cycle(4), 0.0)
    assert lost.value.lost
    assert channel.arrival() == -inf
    with pytest.raises(PortError) as lost:
        channel.receive(0.0)
    assert lost.value.lost
    channel.close()
    assert channel.fileno() == -1
