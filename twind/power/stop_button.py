"""Stop button as input: a serial line protocol, CTS, a GPIO line or a key. Runs in the power process.

Every kind is fail-safe: an unplugged button reads as pressed or unplugged.
"""

import fcntl
import os
import struct
from math import inf
from typing import Protocol

from twind.power.gpio_line import GpioLine
from twind.power.modem_port import ModemPort
from twind.power.power_states import ButtonState

AGAIN = 0.5  # s between attempts to open the device
# s without a byte of a button with a serial protocol: unplugged. Its port stays open, as opening it restarts
# some microcontrollers, which then are silent for a second or two.
SILENT = 0.3
PRESSED = ord("1")
RELEASED = ord("0")
# <linux/input.h>
_EVENT = struct.Struct("llHHi")
_EV_KEY = 1
_KEYS = 96  # bytes of the bit map of all keys
_EVIOCGKEY = 0x80000000 | _KEYS << 16 | ord("E") << 8 | 0x18
_EVIOCGRAB = 0x40044590


class ButtonDevice(Protocol):
    """Open device of a button. Its methods raise OSError when it is gone."""

    def is_pressed(self, now: float) -> bool | None:
        """Return whether the button is pressed, or was since the last call; None: not known."""

    def close(self) -> None:
        """Release the device."""


class SerialButton:
    """Button that sends `0` (released) or `1` (pressed) at least ten times a second."""

    def __init__(self, port: str) -> None:
        self._port = ModemPort(port)
        self._last_at = -inf
        self._pressed: bool | None = None  # None: no byte yet, or silent

    def is_pressed(self, now: float) -> bool | None:
        """Take in the bytes. Bytes of no meaning are ignored; without others the button is silent: None."""
        known = [byte for byte in self._port.read() if byte in (PRESSED, RELEASED)]
        if known:
            self._last_at = now
            self._pressed = known[-1] == PRESSED
        elif now - self._last_at > SILENT:
            self._pressed = None
        return True if PRESSED in known else self._pressed

    def close(self) -> None:
        """Release the port."""
        self._port.close()


class CtsButton:
    """Normally closed contact between RTS and CTS of a serial port: CTS off is pressed or unplugged."""

    def __init__(self, port: str) -> None:
        self._port = ModemPort(port)
        self._port.set_rts(True)

    def is_pressed(self, now: float) -> bool:
        """Read the line."""
        return not self._port.cts()

    def close(self) -> None:
        """Release the port."""
        self._port.close()


class GpioButton:
    """Normally closed contact between a GPIO line and ground: high is pressed or unplugged (pull-up)."""

    def __init__(self, chip: str, line: int) -> None:
        self._line = GpioLine(chip, line, output=False)

    def is_pressed(self, now: float) -> bool:
        """Read the line."""
        return self._line.is_active()

    def close(self) -> None:
        """Release the line."""
        self._line.close()


class KeyButton:
    """Key of an input device (evdev), grabbed: no other program gets its keys."""

    def __init__(self, path: str, key: int) -> None:
        self._fd = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        self._key = key
        try:
            fcntl.ioctl(self._fd, _EVIOCGRAB, 1)
        except OSError:
            os.close(self._fd)
            raise

    def is_pressed(self, now: float) -> bool:
        """Read the events since the last call, and the key as it is now."""
        try:
            data = os.read(self._fd, 64 * _EVENT.size)
        except BlockingIOError:
            data = b""
        whole = len(data) - len(data) % _EVENT.size
        events = _EVENT.iter_unpack(data[:whole])
        was = any((kind, code) == (_EV_KEY, self._key) and value for _, _, kind, code, value in events)
        bits = fcntl.ioctl(self._fd, _EVIOCGKEY, bytes(_KEYS))
        return was or bool(bits[self._key // 8] & 1 << self._key % 8)

    def close(self) -> None:
        """Release the device."""
        os.close(self._fd)


def open_button(kind: str, port: str, line: int, key: int) -> ButtonDevice:
    """Open the device of a button of the robot file. Raises OSError."""
    if kind == "gpio":
        return GpioButton(port, line)
    if kind == "key":
        return KeyButton(port, key)
    return SerialButton(port) if kind == "serial" else CtsButton(port)


class StopButton:
    """The button, its device opened again after each loss."""

    def __init__(self, kind: str, port: str, line: int = -1, key: int = -1) -> None:
        self.trouble = ""  # why the device cannot be used; empty: it can
        self._what = (kind, port, line, key)
        self._device: ButtonDevice | None = None
        self._next = -inf  # s, of the next attempt to open it
        self._was_read = False

    def read(self, now: float) -> ButtonState:
        """Return the state of the button now."""
        kind, port, line, key = self._what
        try:
            if self._device is None:
                if now < self._next:
                    return ButtonState.UNPLUGGED
                self._next = now + AGAIN
                self._device = open_button(kind, port, line, key)
            pressed = self._device.is_pressed(now)
        except OSError as error:
            self.trouble = f"stop button {kind} at {port}: {error.strerror or error}"
            if self._device is not None:
                self._device.close()
            self._device = None
            return ButtonState.UNPLUGGED
        if pressed is None:
            if self._was_read:
                self.trouble = f"stop button {kind} at {port}: no byte for more than {SILENT:g} s"
            return ButtonState.UNPLUGGED if self.trouble else ButtonState.UNKNOWN
        self._was_read = True
        self.trouble = ""
        return ButtonState.PRESSED if pressed else ButtonState.RELEASED
