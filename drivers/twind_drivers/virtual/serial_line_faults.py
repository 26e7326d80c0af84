"""Faults of replies, line and plug of a virtual serial bus, for servos of any family."""

from twind_drivers.virtual.faulty_byte_stream import FaultyByteStream
from twind_drivers.virtual.half_duplex_wire import HalfDuplexWire
from twind_drivers.virtual.line_faults import LineFaults
from twind_drivers.virtual.reply_faults import ReplyFaults


class SerialLineFaults(ReplyFaults, LineFaults):
    """Faults of one line. Each method is an order; `docs/virtual.md` lists them."""

    def __init__(self, wire: HalfDuplexWire, stream: FaultyByteStream) -> None:
        LineFaults.__init__(self, stream)
        ReplyFaults.__init__(self, wire, stream)
        self.plugged = True

    def unplug(self) -> None:
        """The adapter is pulled out: what is under way is lost; the servos keep power and time."""
        self.plugged = False
        self._wire.clear()
        self.stream.forget()

    def replug(self, renamed: bool = False) -> None:
        """The adapter is back. `renamed`: as another device; in process there is no name to change."""
        self.plugged = True

    def look(self) -> None:
        """Update the byte path after a change of faults of replies or line."""
        LineFaults.look(self)
        ReplyFaults.look(self)

    def clear(self) -> None:
        """Heal every fault of replies and line; an unplugged port stays so."""
        LineFaults.clear(self)
        ReplyFaults.clear(self)
