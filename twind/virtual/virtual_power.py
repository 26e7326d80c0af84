"""Supply relay and stop button of a virtual robot, each on a pseudo-terminal.

A pseudo-terminal has no RTS and CTS. Whatever kinds the robot file names, the relay takes the orders of the
LCUS-1, and the button speaks the serial protocol of `twind/power/stop_button.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from twind.power.relay_switch import LCUS_OFF, LCUS_ON
from twind.power.stop_button import PRESSED, RELEASED
from twind.virtual.pty_port import VirtualPtyPort
from twind_drivers.clock import Clock

RELAY = "relay"
BUTTON = "stop_button"
SENT = 0.05  # s between two bytes of the button
# Orders of the faults socket, as the methods of `VirtualPower`
POWER_FAULTS: Mapping[str, Mapping[str, type]] = {
    "button": {"pressed?": bool, "plugged?": bool},
    "relay": {"stuck?": bool, "plugged?": bool},
}


class VirtualPower:
    """Relay and button of one robot. Times are those of the monotonic clock, as real hardware has them."""

    def __init__(
        self, ports: Mapping[str, VirtualPtyPort], switch: Callable[[bool], None], clock: Clock
    ) -> None:
        """`ports` by `RELAY` and `BUTTON`. `switch`: sets the supply of all devices."""
        self.ports = ports
        self._switch = switch
        self._clock = clock
        self._closed = False
        self._stuck = False
        self._changed_at = clock.now()
        self._rest = b""  # of an order that is not complete
        self._pressed = False
        self._sent_at = 0.0
        if RELAY in ports:
            switch(False)

    def filenos(self) -> list[int]:
        """Descriptors to wait for."""
        return [port.fd for port in self.ports.values() if port.present]

    def serve(self) -> None:
        """Take the orders of the relay, and send the state of the button when it is due."""
        now = self._clock.now()
        for name, port in self.ports.items():
            there = port.look()
            if port.fd < 0:
                continue
            data = port.read()  # of a host that has gone too: its last order counts
            if name == RELAY:
                self._take(data)
            elif there and now - self._sent_at >= SENT:
                self._sent_at = now
                port.write(bytes((PRESSED if self._pressed else RELEASED,)))

    def _take(self, data: bytes) -> None:
        self._rest += data
        while len(self._rest) >= len(LCUS_ON):
            order = self._rest[: len(LCUS_ON)]
            known = order in (LCUS_ON, LCUS_OFF)
            self._rest = self._rest[len(order) if known else 1 :]
            if known:
                self._set(order == LCUS_ON)

    def _set(self, closed: bool) -> None:
        if closed is self._closed or (self._stuck and not closed):
            return
        self._closed = closed
        self._changed_at = self._clock.now()
        self._switch(closed)

    # --------------------------------------------------------------------------------- orders

    def button(self, pressed: bool | None = None, plugged: bool | None = None) -> None:
        """Press or release the button, pull or plug its cable. Raises KeyError: there is none."""
        self._pressed = self._pressed if pressed is None else pressed
        self._sent_at = 0.0
        self._plug(BUTTON, plugged)

    def relay(self, stuck: bool | None = None, plugged: bool | None = None) -> None:
        """Weld the contact of the relay, pull or plug its cable: it opens. Raises KeyError: there is none."""
        self._stuck = self._stuck if stuck is None else stuck
        if plugged is False:
            self._set(False)
        self._plug(RELAY, plugged)

    def _plug(self, name: str, plugged: bool | None) -> None:
        port = self.ports[name]
        if plugged is not None:
            port.plug() if plugged else port.unplug()

    def truth(self) -> dict[str, Any]:
        """Return the state of relay and button."""
        return {"closed": self._closed, "changed_at": self._changed_at, "pressed": self._pressed}
