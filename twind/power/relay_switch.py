"""Supply relay behind a device that may come and go. Runs in the power process."""

from math import inf
from typing import Protocol

from twind.power.gpio_line import GpioLine
from twind.power.modem_port import ModemPort
from twind.power.power_states import RelayState

AGAIN = 0.5  # s between attempts to open the device, and between repetitions of the order
# LC Technology, LCUS-1, "LC USB switch communication protocol", 9600 bit/s: start 0xA0, switch number,
# 0 off or 1 on, sum of the bytes before.
LCUS_OFF = bytes((0xA0, 1, 0, 0xA1))
LCUS_ON = bytes((0xA0, 1, 1, 0xA2))


class RelayDevice(Protocol):
    """Open device of a relay. Its methods raise OSError."""

    def set(self, closed: bool) -> None:
        """Close or open the relay."""

    def close(self) -> None:
        """Release the device."""


class LcusDevice:
    """USB relay LCUS-1. It keeps its state when its port is closed."""

    def __init__(self, port: str) -> None:
        self._port = ModemPort(port)

    def set(self, closed: bool) -> None:
        """Send the order."""
        self._port.write(LCUS_ON if closed else LCUS_OFF)

    def close(self) -> None:
        """Release the port once the last order has left."""
        try:
            self._port.drain()
        finally:
            self._port.close()


class RtsDevice:
    """Relay on the line RTS of a serial port: on is closed."""

    def __init__(self, port: str) -> None:
        self._port = ModemPort(port)
        self._port.set_rts(False)  # the kernel sets it at each opening

    def set(self, closed: bool) -> None:
        """Set the line."""
        self._port.set_rts(closed)

    def close(self) -> None:
        """Release the port."""
        self._port.close()


def open_relay(kind: str, port: str, line: int, active_low: bool) -> RelayDevice:
    """Open the device of a relay of the robot file. Raises OSError."""
    if kind == "gpio":
        return GpioLine(port, line, output=True, active_low=active_low)
    return LcusDevice(port) if kind == "lcus1" else RtsDevice(port)


class RelaySwitch:
    """The relay, its device opened again after each loss."""

    def __init__(self, kind: str, port: str, line: int = -1, active_low: bool = False) -> None:
        self.trouble = ""  # why the device cannot be used; empty: it can
        self._what = (kind, port, line, active_low)
        self._device: RelayDevice | None = None
        self._ordered: bool | None = None
        self._next = -inf  # s, of the next attempt or repetition

    def drive(self, closed: bool, now: float) -> RelayState:
        """Order the relay closed or open: at once if that is new, else again from time to time."""
        if closed is not self._ordered or now >= self._next:
            if self._device is not None or now >= self._next:
                self._order(closed)
                self._next = now + AGAIN
            self._ordered = closed
        if self._device is None:
            return RelayState.FAILED
        return RelayState.CLOSED if closed else RelayState.OPEN

    def _order(self, closed: bool) -> None:
        """Send the order; once more by a device opened anew where it fails on one that was open."""
        was_open = self._device is not None
        if not self._try_order(closed) and was_open:
            self._try_order(closed)

    def _try_order(self, closed: bool) -> bool:
        kind, port, line, active_low = self._what
        try:
            if self._device is None:
                self._device = open_relay(kind, port, line, active_low)
            self._device.set(closed)
            self.trouble = ""
        except OSError as error:
            self.trouble = f"relay {kind} at {port}: {error.strerror or error}"
            self.release()
            return False
        return True

    def release(self) -> None:
        """Release the device, and open it anew later."""
        device = self._device
        self._device = None
        if device is not None:
            try:
                device.close()
            except OSError as error:
                self.trouble = self.trouble or str(error)
