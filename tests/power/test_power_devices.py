"""Relay and stop button on devices that note each order, and fail as the test says."""

import os
from typing import Any

import pytest

from twind.power.power_states import ButtonState, RelayState
from twind.power.relay_switch import LCUS_OFF, LCUS_ON, RelaySwitch
from twind.power.stop_button import StopButton

AGAIN = 0.5  # s between two attempts, and two orders
SILENT = 0.3  # s


class Device:
    """A serial port or GPIO line: `notes` has its orders, `failing` those that raise OSError."""

    def __init__(self) -> None:
        self.notes: list[Any] = []
        self.failing: dict[str, OSError] = {}
        self.active = False
        self.data = b""

    def made(self, *given: Any, **named: Any) -> "Device":
        self._note("open", *given, *named.values())
        return self

    def _note(self, what: str, *given: Any) -> None:
        self.notes.append((what, *given))
        if what in self.failing:
            raise self.failing[what]

    def set_rts(self, on: bool) -> None:
        self._note("rts", on)

    def cts(self) -> bool:
        self._note("cts")
        return not self.active

    def set(self, on: bool) -> None:
        self._note("set", on)

    def is_active(self) -> bool:
        self._note("read")
        return self.active

    def write(self, data: bytes) -> None:
        self._note("write", data)

    def read(self) -> bytes:
        self._note("read")
        data, self.data = self.data, b""
        return data

    def drain(self) -> None:
        self._note("drain")

    def close(self) -> None:
        self._note("close")

    def taken(self) -> list[Any]:
        """The notes since the last call."""
        notes, self.notes = self.notes, []
        return notes


@pytest.fixture
def device(monkeypatch: pytest.MonkeyPatch) -> Device:
    device = Device()
    for module in ("relay_switch", "stop_button"):
        for name in ("ModemPort", "GpioLine"):
            monkeypatch.setattr(f"twind.power.{module}.{name}", device.made)
    return device


# ------------------------------------------------------------------------------------------- relay


@pytest.mark.parametrize(
    ("kind", "opened", "orders", "released"),
    [
        ("rts", [("open", "port"), ("rts", False)], [("rts", True), ("rts", False)], [("close",)]),
        ("lcus1", [("open", "port")], [("write", LCUS_ON), ("write", LCUS_OFF)], [("drain",), ("close",)]),
        ("gpio", [("open", "port", 4, True, True)], [("set", True), ("set", False)], [("close",)]),
    ],
)
def test_each_kind_of_relay_is_opened_ordered_and_released_in_its_way(
    device: Device, kind: str, opened: Any, orders: Any, released: Any
) -> None:
    relay = RelaySwitch(kind, "port", 4, True)
    assert relay.trouble == ""
    assert relay.drive(True, 10.0) is RelayState.CLOSED
    assert relay.drive(False, 10.01) is RelayState.OPEN
    assert device.taken() == [*opened, *orders]
    relay.release()
    relay.release()
    assert device.taken() == released and relay.trouble == ""


def test_a_gpio_relay_is_active_high_by_default(device: Device) -> None:
    RelaySwitch("gpio", "port", 4).drive(False, 10.0)
    assert device.taken()[0] == ("open", "port", 4, True, False)


def test_an_order_is_sent_when_it_is_new_and_again_after_half_a_second(device: Device) -> None:
    relay = RelaySwitch("gpio", "port", 4)
    relay.drive(True, 0.0)
    device.taken()
    relay.drive(True, AGAIN - 0.001)
    assert device.taken() == []
    relay.drive(True, AGAIN)
    assert device.taken() == [("set", True)]
    relay.drive(False, AGAIN + 0.01)
    relay.drive(False, 2 * AGAIN)
    assert device.taken() == [("set", False)]
    relay.drive(False, 2 * AGAIN + 0.01)
    assert device.taken() == [("set", False)]


def test_a_missing_relay_is_tried_twice_a_second_whatever_is_ordered(device: Device) -> None:
    device.failing["open"] = OSError(2, "No such file or directory")
    relay = RelaySwitch("lcus1", "port")
    assert relay.drive(False, 0.0) is RelayState.FAILED
    assert relay.trouble == "relay lcus1 at port: No such file or directory"
    for now in (0.1, AGAIN - 0.001):
        assert relay.drive(now < 0.2, now) is RelayState.FAILED
    assert device.taken() == [("open", "port")]
    device.failing.clear()
    assert relay.drive(False, AGAIN) is RelayState.OPEN
    assert device.taken() == [("open", "port"), ("write", LCUS_OFF)] and relay.trouble == ""


def test_an_order_that_fails_is_tried_once_more_with_the_device_opened_anew(device: Device) -> None:
    relay = RelaySwitch("rts", "port")
    relay.drive(True, 10.0)
    device.taken()
    device.failing["rts"] = OSError("the line is gone")
    assert relay.drive(False, 10.01) is RelayState.FAILED
    assert device.taken() == [("rts", False), ("close",), ("open", "port"), ("rts", False)]
    assert relay.trouble == "relay rts at port: the line is gone"


def test_a_port_that_does_not_drain_is_closed_and_reported(device: Device) -> None:
    relay = RelaySwitch("lcus1", "port")
    relay.drive(True, 10.0)
    device.failing["drain"] = OSError("stuck")
    relay.release()
    assert device.taken()[-2:] == [("drain",), ("close",)] and relay.trouble == "stuck"
    relay.drive(True, 11.0)
    device.failing["write"] = OSError(5, "Input/output error")
    assert relay.drive(False, 11.1) is RelayState.FAILED
    assert relay.trouble == "relay lcus1 at port: Input/output error", "the first cause"


# ------------------------------------------------------------------------------------------- button


@pytest.mark.parametrize(
    ("kind", "opened", "read"),
    [
        ("gpio", [("open", "port", 4, False)], ("read",)),
        ("cts", [("open", "port"), ("rts", True)], ("cts",)),
    ],
)
def test_a_contact_is_read_at_each_call(device: Device, kind: str, opened: Any, read: Any) -> None:
    button = StopButton(kind, "port", 4)
    assert button.read(10.0) is ButtonState.RELEASED
    assert device.taken() == [*opened, read]
    device.active = True
    assert button.read(10.01) is ButtonState.PRESSED
    assert device.taken() == [read]


@pytest.mark.parametrize(("kind", "read"), [("gpio", "read"), ("cts", "cts"), ("serial", "read")])
def test_a_button_whose_device_fails_is_closed_and_tried_twice_a_second(
    device: Device, kind: str, read: str
) -> None:
    device.data = b"0"
    button = StopButton(kind, "port", 4)
    assert button.read(0.0) is ButtonState.RELEASED
    device.taken()
    device.failing[read] = OSError(5, "Input/output error")
    assert button.read(0.01) is ButtonState.UNPLUGGED
    assert device.taken() == [(read,), ("close",)]
    assert button.trouble == f"stop button {kind} at port: Input/output error"
    device.failing = {"open": OSError("no chip")}
    assert button.read(AGAIN - 0.001) is ButtonState.UNPLUGGED and device.taken() == []
    assert button.read(AGAIN) is ButtonState.UNPLUGGED
    assert [note[0] for note in device.taken()] == ["open"]
    assert button.trouble == f"stop button {kind} at port: no chip"
    device.failing.clear()
    device.data = b"0"
    assert button.read(2 * AGAIN - 0.001) is ButtonState.UNPLUGGED
    assert button.read(2 * AGAIN) is ButtonState.RELEASED and button.trouble == ""


def test_a_serial_button_is_what_its_last_byte_of_meaning_was(device: Device) -> None:
    button = StopButton("serial", "port")
    for data, state in [
        (b"", ButtonState.UNKNOWN),
        (b"x", ButtonState.UNKNOWN),
        (b"x0\r\n", ButtonState.RELEASED),
        (b"", ButtonState.RELEASED),
        (b"0x1y", ButtonState.PRESSED),
        (b"", ButtonState.PRESSED),
        (b"10", ButtonState.PRESSED),  # pressed since the last call
        (b"", ButtonState.RELEASED),
    ]:
        device.data = data
        assert button.read(10.0) is state, data


def test_a_serial_button_may_be_silent_for_three_tenths_of_a_second(device: Device) -> None:
    device.data = b"1"
    button = StopButton("serial", "port")
    assert button.read(0.0) is ButtonState.PRESSED
    assert button.read(SILENT) is ButtonState.PRESSED
    assert button.read(SILENT + 0.001) is ButtonState.UNPLUGGED
    assert button.trouble == "stop button serial at port: no byte for more than 0.3 s"
    assert ("close",) not in device.notes


@pytest.mark.parametrize(("key", "place"), [(7, (0, 0x80)), (8, (1, 0x01)), (28, (3, 0x10))])
def test_a_key_is_one_bit_of_all(
    device: Device, monkeypatch: pytest.MonkeyPatch, tmp_path: Any, key: int, place: tuple[int, int]
) -> None:
    held = bytearray(96)
    monkeypatch.setattr("twind.power.stop_button.fcntl.ioctl", lambda *_: bytes(held))
    os.mkfifo(tmp_path / "event3")
    writer = os.open(tmp_path / "event3", os.O_RDWR | os.O_NONBLOCK)
    button = StopButton("key", str(tmp_path / "event3"), -1, key)
    at, bit = place
    held[:] = b"\xff" * 96
    held[at] = 0xFF & ~bit
    assert button.read(10.0) is ButtonState.RELEASED
    held[:] = bytes(96)
    held[at] = bit
    assert button.read(10.1) is ButtonState.PRESSED
    os.close(writer)


def test_a_key_that_another_program_has_grabbed_is_unplugged_and_its_descriptor_is_closed(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Any
) -> None:
    def ioctl(*_: Any) -> bytes:
        raise OSError(16, "Device or resource busy")

    monkeypatch.setattr("twind.power.stop_button.fcntl.ioctl", ioctl)
    (tmp_path / "event3").touch()
    before = os.listdir("/proc/self/fd")
    button = StopButton("key", str(tmp_path / "event3"), -1, 28)
    assert button.read(10.0) is ButtonState.UNPLUGGED
    assert button.trouble == f"stop button key at {tmp_path}/event3: Device or resource busy"
    assert len(os.listdir("/proc/self/fd")) == len(before)


def test_a_key_that_is_lost_is_closed(monkeypatch: pytest.MonkeyPatch, tmp_path: Any) -> None:
    lost = False

    def ioctl(*_: Any) -> bytes:
        if lost:
            raise OSError(19, "No such device")
        return bytes(96)

    monkeypatch.setattr("twind.power.stop_button.fcntl.ioctl", ioctl)
    (tmp_path / "event3").write_bytes(b"part of an event")
    before = os.listdir("/proc/self/fd")
    button = StopButton("key", str(tmp_path / "event3"), -1, 28)
    assert button.read(10.0) is ButtonState.RELEASED
    lost = True
    assert button.read(10.1) is ButtonState.UNPLUGGED
    assert len(os.listdir("/proc/self/fd")) == len(before)
