"""Real-time tests of dynamixel serial port."""

import subprocess
import sys
import time
from collections.abc import Iterator

import pytest

from tests.support.serial_port_rig import Terminal
from twind_drivers.bus import PortError
from twind_drivers.clock import MonotonicClock
from twind_drivers.ports.port_holder import holder
from twind_drivers.ports.serial_port import SerialTransport


@pytest.fixture
def terminal() -> Iterator[Terminal]:
    terminal = Terminal()
    yield terminal
    terminal.unplug()


def test_another_process_that_holds_the_port_is_named(terminal: Terminal) -> None:
    code = (
        "import fcntl, os, sys; fd = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY);"
        "fcntl.flock(fd, fcntl.LOCK_EX); print('held', flush=True); sys.stdin.read()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code, terminal.path], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == b"held\n"
        with pytest.raises(PortError, match=rf"pid {other.pid} \(.*python"):
            SerialTransport(terminal.path, 1_000_000)
        assert f"pid {other.pid}" in holder(terminal.path)
        other.communicate()
    SerialTransport(terminal.path, 1_000_000).close()


@pytest.mark.parametrize("act", ["read", "write", "drain", "backlog", "flush", "baud"])
def test_the_first_call_after_an_unplug_raises_a_lost_port_error(terminal: Terminal, act: str) -> None:
    """Measured on a pty whose master closed: read and write EIO, poll IN|ERR|HUP (facts 13)."""
    port = SerialTransport(terminal.path, 1_000_000)
    actions = {
        "read": lambda: port.read_into(memoryview(bytearray(4))),
        "write": lambda: port.write(b"x"),
        "drain": port.drain,
        "backlog": port.backlog,
        "flush": port.flush,
        "baud": lambda: port.set_baud(57_600),
    }
    terminal.unplug()
    started = time.monotonic()
    MonotonicClock().wait([port], time.monotonic() + 5.0)  # a hang-up wakes whoever waits for bytes
    assert time.monotonic() - started < 0.05
    with pytest.raises(PortError, match="its program has ended") as caught:
        actions[act]()
    assert caught.value.lost
    port.close()
    with pytest.raises(PortError) as caught:
        actions[act]()
    assert caught.value.lost
