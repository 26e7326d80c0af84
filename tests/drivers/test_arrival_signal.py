"""Bytes of a terminal are announced by a signal: all are read, and none is waited for."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator

import pytest

from tests.support.serial_port_rig import Terminal
from twind_drivers.bus import PortError
from twind_drivers.clock import MonotonicClock
from twind_drivers.ports.arrival_signal import ArrivalSignal
from twind_drivers.ports.serial_port import UNANNOUNCED, SerialTransport

NOBODY = 65534


@pytest.fixture
def terminal() -> Iterator[Terminal]:
    terminal = Terminal()
    yield terminal
    terminal.unplug()


def taken(port: SerialTransport, count: int, room: int) -> bytes:
    """`count` bytes, at most `room` a read, each read after a wait that a byte has to end."""
    clock = MonotonicClock()
    found = b""
    while len(found) < count:
        assert list(clock.wait([port], clock.now() + 10.0)) == [0], f"{len(found)} of {count}"
        buffer = bytearray(room)
        found += buffer[: port.read_into(memoryview(buffer))]
    return found


def opened(terminal: Terminal) -> SerialTransport:
    port = SerialTransport(terminal.path, 1_000_000, by_signal=True)
    assert (port.warning, os.readlink(f"/proc/self/fd/{port.fileno()}")) == ("", "anon_inode:[signalfd]")
    return port


@pytest.mark.parametrize("room", [1, 7, 256, 4096])
def test_every_byte_ends_a_wait_and_is_read(terminal: Terminal, room: int) -> None:
    port = opened(terminal)
    for _ in range(20):
        every = os.urandom(300)
        for at in range(0, 300, 100):
            os.write(terminal.master, every[at : at + 100])
        assert taken(port, 300, room) == every
    port.close()


def test_bytes_that_came_before_the_port_was_ready_are_announced(terminal: Terminal) -> None:
    terminal_fd = os.open(terminal.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    os.write(terminal.master, b"early")
    arrivals = ArrivalSignal(terminal_fd)
    assert arrivals.take()
    os.close(terminal_fd)
    arrivals.close()


def test_a_drain_takes_what_has_come(terminal: Terminal) -> None:
    port = opened(terminal)
    thrown = bytearray()
    assert port.drain(thrown) == 0
    os.write(terminal.master, b"late reply")
    clock = MonotonicClock()
    assert list(clock.wait([port], clock.now() + 10.0)) == [0]
    assert port.drain(thrown) == len(thrown) == 10
    assert port.read_into(memoryview(bytearray(10))) == 0
    port.close()


def test_a_wait_for_two_ports_names_the_one_with_bytes(terminal: Terminal) -> None:
    other = Terminal()
    ports = [opened(each) for each in (terminal, other)]
    clock = MonotonicClock()
    clock.wait(ports, clock.now())
    for port in ports:
        port.drain()
    os.write(other.master, b"here")
    assert list(clock.wait(ports, clock.now() + 10.0)) == [1]
    assert taken(ports[1], 4, 16) == b"here"
    for port in ports:
        port.close()
    other.unplug()


def test_a_hang_up_shows_at_the_next_write_and_without_one_after_some_reads(terminal: Terminal) -> None:
    port = opened(terminal)
    port.drain()
    terminal.unplug()
    with pytest.raises(PortError) as caught:
        port.write(b"x")
    assert caught.value.lost
    buffer = memoryview(bytearray(8))
    for _ in range(UNANNOUNCED - 1):
        assert port.read_into(buffer) == 0
    with pytest.raises(PortError) as caught:
        port.read_into(buffer)
    assert caught.value.lost
    port.close()
    assert port.fileno() == -1
    with pytest.raises(PortError):
        port.read_into(buffer)


def test_a_port_that_answers_is_never_asked_whether_it_is_there(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    port = opened(terminal)
    asked = []
    monkeypatch.setattr(port, "backlog", lambda: asked.append(1))
    for _ in range(3 * UNANNOUNCED):
        port.drain()
        os.write(terminal.master, b"reply")
        assert taken(port, 5, 16) == b"reply"
    assert not asked
    monkeypatch.undo()
    port.close()


def test_signals_are_given_back(terminal: Terminal) -> None:
    begun = len(os.listdir("/proc/self/fd"))
    for _ in range(100):
        port = opened(terminal)
        port.close()
    assert len(os.listdir("/proc/self/fd")) == begun


def test_a_port_works_without_a_free_signal(terminal: Terminal, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(signal, "SIGRTMIN", signal.SIGRTMAX + 1)
    port = SerialTransport(terminal.path, 1_000_000, by_signal=True)
    assert "no signal" in port.warning
    os.write(terminal.master, b"here")
    assert taken(port, 4, 16) == b"here"
    port.close()


def test_announcements_of_bytes_that_were_read_cost_one_more_read(terminal: Terminal) -> None:
    port = opened(terminal)
    port.drain()
    for _ in range(100):
        os.write(terminal.master, b"x")
    buffer = bytearray(4096)
    found = 0
    while found < 100:
        assert list(MonotonicClock().wait([port], time.monotonic() + 10.0)) == [0]
        found += port.read_into(memoryview(buffer))
    time.sleep(0.1)
    port.read_into(memoryview(buffer))
    assert list(MonotonicClock().wait([port], time.monotonic())) == []
    port.close()


def test_settling_makes_what_was_received_readable(terminal: Terminal) -> None:
    port = opened(terminal)
    port.drain()
    os.write(terminal.master, b"here")
    port.settle()
    assert port.read_into(memoryview(bytearray(8))) == 4
    port.settle()
    port.close()
    port.settle()


def test_a_full_queue_of_signals_ends_no_process_and_loses_no_byte(terminal: Terminal) -> None:
    other = Terminal()
    program = f"""
import os, resource
from twind_drivers.clock import MonotonicClock
from twind_drivers.ports.serial_port import SerialTransport
ports = [SerialTransport(path, 1_000_000, by_signal=True) for path in {[terminal.path, other.path]}]
for port in ports:
    port.drain()
resource.setrlimit(resource.RLIMIT_SIGPENDING, (0, 0))
os.setresuid({NOBODY}, {NOBODY}, {NOBODY}) if os.geteuid() == 0 else None
print("begun", flush=True)
clock = MonotonicClock()
room = memoryview(bytearray(2))
found = [0, 0]
while found != [0, 4]:
    ready = clock.wait(ports, clock.now() + 10.0)
    assert 1 in ready, found
    for place in ready:
        found[place] += ports[place].read_into(room)
"""
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "begun\n"
        os.write(other.master, b"here")
        assert process.wait(30) == 0
    other.unplug()
