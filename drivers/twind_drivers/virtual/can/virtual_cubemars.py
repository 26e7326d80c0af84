"""Virtual CubeMars AK motor in MIT mode: it reports only in reply to its own frames.

Sources: CubeMars AK manual V1.0.8 p. 48-49. Its answer has its own id (the manual: "0 + drive ID"), and its
first byte is that id too. Not in the manual: the error codes (public drivers, unverified), and what FB does.
"""

from collections.abc import Sequence
from math import inf

from twind_drivers.virtual.can.bit_fields import mit_command, mit_state
from twind_drivers.virtual.can.can_message import CanMessage
from twind_drivers.virtual.can.can_motors import CanMotors
from twind_drivers.virtual.can.node import HEAT, LOW, VirtualCanNode
from twind_drivers.virtual.can.node_spec import NodeSpec

OVER_TEMPERATURE = 1
OVER_VOLTAGE = 3
UNDER_VOLTAGE = 4
ENTER = 0xFC
EXIT = 0xFD
ORIGIN = 0xFE


class VirtualCubeMars(VirtualCanNode):
    """Virtual CubeMars.

    `settings`: `timeout` s of its watchdog, which only the vendor's own tool can set or read.
    """

    def __init__(self, spec: NodeSpec, row: int, motors: CanMotors, now: float) -> None:
        super().__init__(spec, row, motors, now)
        self.watch.timeout = spec.settings.get("timeout", 0.0) or inf
        self.boot(now)

    def encode_fault(self, what: str) -> int:
        """Error byte."""
        return OVER_TEMPERATURE if what == HEAT else UNDER_VOLTAGE if what == LOW else OVER_VOLTAGE

    def inject_fault(self, bits: int) -> Sequence[CanMessage]:
        """One error code: the first one stays."""
        return super().inject_fault(0 if self.fault else bits)

    def handle_frame(self, message: CanMessage, now: float) -> Sequence[CanMessage]:
        """Commands and the three special frames; entering motor mode forgets an error (assumed)."""
        if message.id != self.id or len(message.data) != 8:
            return ()
        self.watch.heard_at = now
        if message.data[:7] == bytes([255] * 7) and ENTER <= message.data[7] <= ORIGIN:
            self._special(message.data[7])
        else:
            self.shaft.follow(*mit_command(message.data, self.spans))
        state = mit_state(*self.shaft.read_state(), self.spans)
        warm = round(self.celsius) & 0xFF
        return [CanMessage(self.id, bytes([self.id & 0xFF]) + state + bytes([warm, self.fault & 0xFF]))]

    def _special(self, order: int) -> None:
        if order == ENTER:
            self.clear()
            self.enable()
        elif order == EXIT:
            self.shaft.disable()
        else:
            self.shaft.set_zero()
