"""Serial ports on real pseudo-terminals: exclusive, raw, and every failure says what to do."""

import errno
import fcntl
import os
import struct
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import serial

from tests.support.driver_rig import is_output_full
from tests.support.serial_port_rig import Terminal
from twind_drivers.bus import PortError
from twind_drivers.ports import port_holder, serial_port
from twind_drivers.ports.port_holder import command, holder
from twind_drivers.ports.serial_port import SerialTransport


@pytest.fixture
def terminal() -> Iterator[Terminal]:
    terminal = Terminal()
    yield terminal
    terminal.unplug()


def taken(port: SerialTransport, count: int) -> bytes:
    """`count` bytes, waiting for them."""
    buffer = bytearray(count)
    got = 0
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
    assert (port.latency_ms, port.warning) == (None, "")  # a pty has no such timer
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
    deadline = time.monotonic() + 60.0
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


def test_a_loop_that_opens_a_taken_port_again_and_again_looks_into_no_other_process(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its ticks would wait for it: 12 ms of computing beside 130 processes (30 November 2026)."""
    monkeypatch.setattr(port_holder, "_openers", lambda path: pytest.fail("searched"))
    first = SerialTransport(terminal.path, 1_000_000)
    with pytest.raises(PortError, match=rf"in use by pid {os.getpid()} "):
        SerialTransport(terminal.path, 1_000_000, by_signal=True)
    monkeypatch.setattr(port_holder, "_lockers", lambda path: ())
    with pytest.raises(PortError, match=rf"in use by another process \(`fuser -v {terminal.path}`\);"):
        SerialTransport(terminal.path, 1_000_000, by_signal=True)
    first.close()


def test_a_port_that_goes_while_it_is_opened_is_lost_and_let_go_of(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = fcntl.ioctl

    def ioctl(fd: int, question: int, *more: Any) -> Any:
        if question == termios.TIOCEXCL:
            raise OSError(errno.EIO, "unplugged")
        return asked(fd, question, *more)

    monkeypatch.setattr(serial_port.os.path, "realpath", lambda path: "/dev/ttyUSB0")
    monkeypatch.setattr(serial_port.fcntl, "ioctl", ioctl)
    before = sorted(os.listdir("/proc/self/fd"))
    with pytest.raises(PortError, match="open failed") as caught:
        SerialTransport(terminal.path, 1_000_000)
    assert caught.value.lost
    assert sorted(os.listdir("/proc/self/fd")) == before


def test_a_port_holder_that_is_not_visible_is_reported_as_hidden(tmp_path: os.PathLike[str]) -> None:
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


def test_the_rate_of_an_open_port_can_be_changed(terminal: Terminal) -> None:
    port = SerialTransport(terminal.path, 57_600)
    for baud, speed in ((2_000_000, termios.B2000000), (4_500_000, None), (9_600, termios.B9600)):
        port.set_baud(baud)
        assert port.baud == baud
        assert speed is None or termios.tcgetattr(port.fileno())[4:6] == [speed, speed]
    for wrong in (0, -1, 2**40):
        with pytest.raises(PortError, match=f"baud rate {wrong} is not supported") as caught:
            port.set_baud(wrong)
        assert not caught.value.lost
    assert port.baud == 9_600
    port.close()


@pytest.mark.parametrize(
    ("real", "fits"), [(4_500_000, True), (4_400_000, True), (4_000_000, False), (0, False)]
)
def test_a_rate_that_the_kernel_rounds_too_far_is_refused(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch, real: int, fits: bool
) -> None:
    """The vendor's list ends at 4 Mbaud, servos go to 4.5: a divisor that no adapter may have (facts 13)."""
    asked = fcntl.ioctl

    def ioctl(fd: int, question: int, answer: Any = 0, *more: Any) -> Any:
        if question == serial_port.TCGETS2:
            struct.pack_into("=I", answer, serial_port.SPEED_AT, real)
            return 0
        return asked(fd, question, answer, *more)

    monkeypatch.setattr(serial_port.fcntl, "ioctl", ioctl)
    if fits:
        SerialTransport(terminal.path, 4_500_000).close()
        return
    with pytest.raises(PortError, match=f"baud rate 4500000 is not supported: the adapter makes it {real}"):
        SerialTransport(terminal.path, 4_500_000)
    monkeypatch.undo()
    SerialTransport(terminal.path, 1_000_000).close()  # the refused one was let go of


@pytest.mark.parametrize("baud", [0, -1, 2**40])
def test_a_baud_rate_that_cannot_be_is_refused(terminal: Terminal, baud: int) -> None:
    with pytest.raises(PortError, match=f"baud rate {baud} is not supported"):
        SerialTransport(terminal.path, baud)


def test_no_permission_names_the_group_and_the_remedy(terminal: Terminal) -> None:
    os.chmod(terminal.path, 0)
    code = (
        "import os, sys\n"
        "from twind_drivers.ports.serial_port import PortError, SerialTransport\n"
        "if os.geteuid() == 0: os.setgroups([]); os.setgid(65534); os.setuid(65534)\n"
        "try: SerialTransport(sys.argv[1], 57600)\n"
        "except PortError as error: print(error)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, terminal.path], capture_output=True, text=True, check=True
    )
    assert "no permission" in done.stdout
    assert "usermod -aG" in done.stdout


@pytest.mark.parametrize("waiting", [0, 1, 300, 70_000])
def test_the_backlog_is_the_count_of_the_kernel_driver(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch, waiting: int
) -> None:
    port = SerialTransport(terminal.path, 1_000_000)

    def ioctl(fd: int, question: int, answer: Any) -> int:
        assert (fd, question) == (port.fileno(), termios.TIOCOUTQ)
        struct.pack_into("=i", answer, 0, waiting)
        return 0

    monkeypatch.setattr(serial_port.fcntl, "ioctl", ioctl)
    assert port.backlog() == waiting
    monkeypatch.undo()
    port.close()


@pytest.mark.parametrize(
    ("timer", "slow"), [("1", False), ("2", True), ("16", True), ("x", None), (None, None)]
)
def test_a_latency_timer_that_stayed_long_is_a_warning_with_the_remedy(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch, timer: str | None, slow: bool | None
) -> None:
    """The ioctl has been seen to do nothing, so it is read back (DynamixelSDK pull 116, issue 511)."""

    def read_text(path: Path) -> str:
        assert str(path) == f"/sys/class/tty/{os.path.basename(terminal.path)}/device/latency_timer"
        if timer is None:
            raise FileNotFoundError
        return timer + "\n"

    monkeypatch.setattr(serial_port.Path, "read_text", read_text)
    port = SerialTransport(terminal.path, 1_000_000)
    assert port.latency_ms == (None if slow is None else int(timer or 0))
    assert bool(port.warning) == bool(slow)
    if slow:
        assert f"is {timer} ms" in port.warning
        for remedy in ("latency_timer", "setserial", "ATTR{latency_timer}"):
            assert remedy in port.warning
    port.close()


@pytest.mark.parametrize("taken", [0, 1, 23])
def test_a_packet_that_was_taken_in_part_is_thrown_away_and_not_continued(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch, taken: int
) -> None:
    port = SerialTransport(terminal.path, 1_000_000)
    flushed: list[int] = []
    monkeypatch.setattr(serial_port.os, "write", lambda fd, data: taken)
    monkeypatch.setattr(port, "backlog", lambda: 300)
    monkeypatch.setattr(serial_port.termios, "tcflush", lambda fd, queue: flushed.append(queue))
    with pytest.raises(PortError, match=r"300 bytes still wait.*had 24", check=is_output_full):
        port.write(bytes(24))
    assert flushed == [termios.TCOFLUSH]
    monkeypatch.undo()
    port.close()


def opened_again(terminal: Terminal) -> SerialTransport:
    """The port, once its closing has ended: of a loaded machine that may last."""
    for _ in range(1000):
        try:
            return SerialTransport(terminal.path, 1_000_000)
        except PortError as error:
            if "still being closed" not in error.reason:
                raise
            time.sleep(0.01)
    raise AssertionError("never closed")


@pytest.mark.parametrize("by_signal", [False, True])
def test_a_port_whose_adapter_takes_no_bytes_is_closed_in_the_background(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch, by_signal: bool
) -> None:
    """The kernel waits 30 s (closing_wait) for bytes to leave: the loop would stop for all other buses."""
    port = SerialTransport(terminal.path, 1_000_000, by_signal=by_signal)
    unplugged = threading.Event()
    close = serial.Serial.close

    def blocked(self: serial.Serial) -> None:
        unplugged.wait(60.0)
        close(self)

    monkeypatch.setattr(serial.Serial, "close", blocked)
    monkeypatch.setattr(port, "backlog", lambda: 5)
    begun = time.monotonic()
    port.close()
    port.close()
    assert port.fileno() == -1
    with pytest.raises(PortError, match="is still being closed"):
        SerialTransport(terminal.path, 1_000_000)
    assert time.monotonic() - begun < 10.0
    unplugged.set()
    opened_again(terminal).close()


def test_a_port_whose_last_packet_leaves_in_time_can_be_opened_again(terminal: Terminal) -> None:
    port = SerialTransport(terminal.path, 1_000_000)
    port.backlog = lambda: 5  # type: ignore[method-assign]
    port.close()
    opened_again(terminal).close()


def test_a_port_is_closed_although_no_further_thread_is_permitted(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(self: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    port = SerialTransport(terminal.path, 1_000_000)
    monkeypatch.setattr(port, "backlog", lambda: 5)
    monkeypatch.setattr(threading.Thread, "start", refuse)
    port.close()
    SerialTransport(terminal.path, 1_000_000).close()


def test_an_output_that_is_full_is_an_error_but_not_a_loss(terminal: Terminal) -> None:
    port = SerialTransport(terminal.path, 1_000_000)

    def fill() -> None:
        for _ in range(100):
            port.write(bytes(4000))

    with pytest.raises(PortError, match=r"had 4000.*is the adapter stuck", check=is_output_full):
        fill()
    port.close()
