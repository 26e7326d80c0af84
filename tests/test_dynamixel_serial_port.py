"""Serial ports on real pseudo-terminals: exclusive, raw, and every failure says what to do."""

import os
import pty
import subprocess
import sys
import termios
import time
from collections.abc import Iterator

import pytest

from twind_drivers.bus import PortError
from twind_drivers.dynamixel.holder import command, holder
from twind_drivers.dynamixel.serial_port import SerialTransport


class Terminal:
    """A pty: `path` for the port, `master` for the other end."""

    def __init__(self) -> None:
        self.master, self.slave = pty.openpty()
        self.path = os.ttyname(self.slave)
        self.open = True

    def unplug(self) -> None:
        if self.open:
            self.open = False
            os.close(self.master)
            os.close(self.slave)


@pytest.fixture
def terminal() -> Iterator[Terminal]:
    terminal = Terminal()
    yield terminal
    terminal.unplug()


def taken(port: SerialTransport, count: int) -> bytes:
    """`count` bytes, waiting for them."""
    buffer, got = bytearray(count), 0
    for _ in range(2000):
        got += port.read_into(memoryview(buffer)[got:])
        if got == count:
            break
        time.sleep(0.001)
    return bytes(buffer[:got])


@pytest.mark.parametrize("baud", [57_600, 1_000_000, 2_000_000, 4_500_000])
def test_every_byte_passes_both_ways_unchanged(terminal: Terminal, baud: int) -> None:
    port = SerialTransport(terminal.path, baud)
    every = bytes(range(256))
    port.write(every)
    assert os.read(terminal.master, 512) == every
    os.write(terminal.master, every)
    assert taken(port, 256) == every
    assert port.low_latency is None
    port.close()
    port.close()
    assert port.fileno() == -1


def test_a_known_baud_rate_is_really_set(terminal: Terminal) -> None:
    port = SerialTransport(terminal.path, 2_000_000)
    assert termios.tcgetattr(port.fileno())[4:6] == [termios.B2000000, termios.B2000000]
    port.close()


def test_reading_never_blocks_and_draining_counts(terminal: Terminal) -> None:
    port = SerialTransport(terminal.path, 1_000_000)
    assert port.read_into(memoryview(bytearray(10))) == 0
    assert port.drain() == 0
    os.write(terminal.master, bytes(100))
    deadline = time.monotonic() + 2.0
    thrown = 0
    while thrown < 100 and time.monotonic() < deadline:
        thrown += port.drain()
    assert thrown == 100
    assert port.read_into(memoryview(bytearray(10))) == 0
    port.close()


def test_a_second_open_is_refused_and_names_the_holder(terminal: Terminal) -> None:
    first = SerialTransport(terminal.path, 1_000_000)
    with pytest.raises(PortError, match=rf"in use by pid {os.getpid()} ") as caught:
        SerialTransport(terminal.path, 1_000_000)
    assert not caught.value.lost
    first.close()
    SerialTransport(terminal.path, 1_000_000).close()


@pytest.mark.realtime
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


def test_a_holder_that_cannot_be_seen_is_said_to_be_hidden(tmp_path: os.PathLike[str]) -> None:
    assert "not visible" in holder(os.path.join(tmp_path, "nothing"))
    assert command(2**22 + 1) == "name hidden"


@pytest.mark.parametrize(
    ("path", "words"),
    [
        ("/dev/tty-that-is-not", "no such port"),
        ("/etc/hostname", "not a character device"),
        ("/dev/null", "not a serial port"),
        ("/dev", "not a character device"),
    ],
)
def test_a_path_that_is_no_port_is_refused_with_the_reason(path: str, words: str) -> None:
    with pytest.raises(PortError, match=words) as caught:
        SerialTransport(path, 1_000_000)
    assert path in str(caught.value)


@pytest.mark.parametrize("baud", [0, -1, 2**40])
def test_a_baud_rate_that_cannot_be_is_refused(terminal: Terminal, baud: int) -> None:
    with pytest.raises(PortError, match=f"baud rate {baud} is not supported"):
        SerialTransport(terminal.path, baud)


def test_no_permission_names_the_group_and_the_remedy(terminal: Terminal) -> None:
    os.chmod(terminal.path, 0)
    code = (
        "import os, sys\n"
        "from twind_drivers.dynamixel.serial_port import PortError, SerialTransport\n"
        "if os.geteuid() == 0: os.setgroups([]); os.setgid(65534); os.setuid(65534)\n"
        "try: SerialTransport(sys.argv[1], 57600)\n"
        "except PortError as error: print(error)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, terminal.path], capture_output=True, text=True, check=True
    )
    assert "no permission" in done.stdout
    assert "usermod -aG" in done.stdout


def test_an_unplugged_port_is_lost_for_reading_writing_and_draining(terminal: Terminal) -> None:
    port = SerialTransport(terminal.path, 1_000_000)
    terminal.unplug()
    for act in (lambda: port.read_into(memoryview(bytearray(4))), lambda: port.write(b"x"), port.drain):
        with pytest.raises(PortError) as caught:
            act()
        assert caught.value.lost
        assert "unplugged" in str(caught.value)
    port.close()
    with pytest.raises(PortError, match="closed"):
        port.write(b"x")


def test_an_output_that_is_full_is_an_error_but_not_a_loss(terminal: Terminal) -> None:
    port = SerialTransport(terminal.path, 1_000_000)

    def fill() -> None:
        for _ in range(100):
            port.write(bytes(4000))

    with pytest.raises(PortError, match="of 4000 bytes taken") as caught:
        fill()
    assert not caught.value.lost
    port.close()
