"""The stop button: every kind reads as pressed or unplugged where its signal is gone."""

import os
import struct
import sys
import termios
from pathlib import Path

import pytest

from tests.support.pty_wire import PtyWire
from twind.power.power_states import ButtonState
from twind.power.stop_button import AGAIN, SILENT, StopButton


@pytest.fixture
def wire(tmp_path: Path) -> PtyWire:
    return PtyWire(tmp_path / "button")


def test_the_serial_button_is_unknown_until_its_first_byte(wire: PtyWire) -> None:
    button = StopButton("serial", str(wire.path))
    assert button.read(10.0) is ButtonState.UNKNOWN
    os.write(wire.fd, b"0")
    assert button.read(10.01) is ButtonState.RELEASED
    os.write(wire.fd, b"0\r\n1")
    assert button.read(10.02) is ButtonState.PRESSED
    os.write(wire.fd, b"0")
    assert button.read(10.03) is ButtonState.RELEASED


def test_a_short_press_between_two_rounds_counts(wire: PtyWire) -> None:
    button = StopButton("serial", str(wire.path))
    button.read(10.0)
    os.write(wire.fd, b"010")
    assert button.read(10.01) is ButtonState.PRESSED


@pytest.mark.parametrize("noise", [b"", b"\xff\xff"])
def test_a_silent_or_babbling_line_is_unplugged_until_it_speaks_again(wire: PtyWire, noise: bytes) -> None:
    button = StopButton("serial", str(wire.path))
    button.read(10.0)
    os.write(wire.fd, b"0")
    assert button.read(10.1) is ButtonState.RELEASED
    os.write(wire.fd, noise or b"0"[:0])
    assert button.read(10.1 + SILENT - 0.01) is ButtonState.RELEASED
    assert button.read(10.1 + SILENT + 0.01) is ButtonState.UNPLUGGED
    assert str(wire.path) in button.trouble
    wire.path.unlink()  # it cannot be opened again, and need not be
    later = 10.2 + SILENT + AGAIN
    assert button.read(later) is ButtonState.UNPLUGGED
    os.write(wire.fd, b"0")
    assert button.read(later + 0.01) is ButtonState.RELEASED
    assert button.trouble == ""


def test_a_serial_button_whose_controller_still_starts_is_unknown_for_as_long_as_the_loop_waits(
    wire: PtyWire,
) -> None:
    button = StopButton("serial", str(wire.path))
    for now in (10.0, 11.0, 14.0):
        assert button.read(now) is ButtonState.UNKNOWN
    assert button.trouble == ""
    os.write(wire.fd, b"1")
    assert button.read(14.01) is ButtonState.PRESSED


def test_a_serial_button_that_is_plugged_in_again_is_unplugged_until_its_first_byte(
    wire: PtyWire, tmp_path: Path
) -> None:
    button = StopButton("serial", str(wire.path))
    os.write(wire.fd, b"0")
    assert button.read(10.0) is ButtonState.RELEASED
    wire.unplug()
    assert button.read(10.1) is ButtonState.UNPLUGGED
    again = PtyWire(tmp_path / "button")
    assert button.read(10.1 + AGAIN) is ButtonState.UNPLUGGED
    os.write(again.fd, b"0")
    assert button.read(10.2 + AGAIN) is ButtonState.RELEASED


def test_a_pulled_cable_is_seen_at_once(wire: PtyWire) -> None:
    button = StopButton("serial", str(wire.path))
    button.read(10.0)
    os.write(wire.fd, b"0")
    button.read(10.01)
    wire.unplug()
    assert button.read(10.02) is ButtonState.UNPLUGGED


@pytest.mark.parametrize("kind", ["serial", "cts", "gpio", "key"])
def test_a_missing_device_is_unplugged(tmp_path: Path, kind: str) -> None:
    button = StopButton(kind, str(tmp_path / "none"), 4, 28)
    assert button.read(10.0) is ButtonState.UNPLUGGED
    assert button.trouble.startswith(f"stop button {kind} at {tmp_path}")


def test_a_device_of_another_kind_is_unplugged(wire: PtyWire) -> None:
    for kind in ("cts", "key"):
        assert StopButton(kind, str(wire.path), -1, 28).read(10.0) is ButtonState.UNPLUGGED


def test_the_key_is_read_from_its_events_and_from_its_state(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "event3"
    os.mkfifo(path)
    sender = os.open(path, os.O_RDWR | os.O_NONBLOCK)
    held = bytearray(96)
    grabbed = []

    def ioctl(fd: int, request: int, argument: object) -> bytes:
        if request == 0x40044590:  # EVIOCGRAB
            grabbed.append(argument)
            return b""
        assert request == 0x80604518  # EVIOCGKEY(96)
        return bytes(held)

    monkeypatch.setattr("twind.power.stop_button.fcntl.ioctl", ioctl)
    button = StopButton("key", str(path), -1, 28)
    assert button.read(10.0) is ButtonState.RELEASED
    assert grabbed == [1]
    for code, value, expected in [(28, 1, True), (30, 1, False), (28, 0, False)]:
        os.write(sender, struct.pack("llHHi", 0, 0, 1, code, value) + struct.pack("llHHi", 0, 0, 0, 0, 0))
        assert (button.read(10.1) is ButtonState.PRESSED) is expected
    held[28 // 8] = 1 << 28 % 8
    assert button.read(10.2) is ButtonState.PRESSED
    os.close(sender)


def test_a_contact_between_rts_and_cts_stops_when_it_opens(
    wire: PtyWire, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = {"cts": termios.TIOCM_CTS, "rts": 0}

    def ioctl(fd: int, request: int, argument: bytes) -> bytes:
        if request == termios.TIOCMBIS:
            lines["rts"] |= int.from_bytes(argument, sys.byteorder)
        return lines["cts"].to_bytes(4, sys.byteorder)

    monkeypatch.setattr("twind.power.modem_port.fcntl.ioctl", ioctl)
    button = StopButton("cts", str(wire.path))
    assert button.read(10.0) is ButtonState.RELEASED
    assert lines["rts"] == termios.TIOCM_RTS
    lines["cts"] = 0
    assert button.read(10.1) is ButtonState.PRESSED
