"""CAN controller of the host on the virtual wire: its bus state, its send queue, its received frames.

Error frames are those of linux/can/error.h; a kernel socket gives them to the host, slcan does not.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from math import inf

from twind_drivers.ports.frame import ERROR
from twind_drivers.virtual.can.can_message import CanMessage
from twind_drivers.virtual.can.can_wire import HOST, CanWire

# classes of error
CONTROLLER = 0x04
PROTOCOL = 0x08
OFF = 0x40
BUS_ERROR = 0x80
RESTARTED = 0x100
PASSIVE = 0x10 | 0x20  # second byte of a controller's: receiving and sending
AGAIN_ACTIVE = 0x40
BROKEN = 23  # bits that an error frame takes: flag, its echoes, delimiter


@dataclass(frozen=True, slots=True)
class CanAdapter:
    """Properties of the adapter's construction, which no `clear` changes."""

    queue: int = 64  # frames that it takes beyond those that have left
    keeps: bool = False  # closing the channel leaves them in it; they go out when it is opened again
    acknowledges: bool = True  # slcan: a line that was taken is answered with z or Z
    batch: float = 0.0  # s: text comes to the host at whole multiples, 1 ms over full-speed USB; 0: at once


class VirtualHostController:
    """Controller of the host. Times are s. Down until a channel is opened; then acknowledges all frames."""

    def __init__(
        self, wire: CanWire, adapter: CanAdapter, bitrate: int, may_send: Callable[[], bool]
    ) -> None:
        """`may_send`: True if a node is there to acknowledge."""
        self.wire = wire
        self.adapter = adapter
        self.may_send = may_send
        # work for the bus: any; error frames to spend time on
        self.news = True
        self.broken = 0
        self.inbox: deque[CanMessage] = deque()  # has arrived, error frames among it
        self.since = -inf  # s, when the first of those came; -inf: at some time before
        self.refused = 0  # frames that it did not take
        self.rate = bitrate  # that the host has set
        self.listens_only = False
        self.up = self.off = self.passive = False
        self.plugged = True
        self.heal()

    def heal(self) -> None:
        """Remove all faults of line and adapter."""
        self.cut = self.stalled = self.echo = False
        self.go_offline(False)
        self.doubt(False)

    def update_membership(self) -> None:
        """Mark that the set of permitted senders has changed; the bus supplies the time of the change."""
        self.news = True

    def connect(self, on: bool, *, listens_only: bool = False) -> None:
        """Open or close the channel.

        Closing purges the queue, unless the adapter keeps it, and ends a bus-off.
        """
        if not on and not self.adapter.keeps:
            self.purge()
        self.up = on
        self.listens_only = listens_only
        self.off = False
        if not on:
            self.inbox.clear()
        self.update_membership()

    def plug(self, on: bool) -> None:
        """Give the adapter power, or remove it with all frames that it holds."""
        self.plugged = on
        self.up = False
        self.purge()
        self.inbox.clear()

    def purge(self) -> None:
        """Drop the frames that have not left."""
        self.wire.drop(HOST)
        self.update_membership()

    def backlog(self) -> int:
        """Return the number of frames that wait."""
        return self.wire.count(HOST)

    def take(self, message: CanMessage, now: float) -> bool:
        """Queue a frame of the host. False: the channel is down or the queue full, and the frame is lost."""
        if not self.up or self.listens_only or self.backlog() >= self.adapter.queue:
            self.refused += 1
            return False
        self.wire.put(HOST, message, now)
        return True

    def sound(self) -> bool:
        """Return True if it is on the bus, so that it acknowledges and may send."""
        there = self.plugged and self.up and not self.off and not self.cut
        return there and self.rate == self.wire.bitrate

    def receive_frame(self, message: CanMessage, now: float) -> None:
        """Receive a frame that has passed the wire."""
        if self.sound():
            self.since = self.since if self.inbox else now
            self.inbox.append(message)

    # ------------------------------------------------------------------------------------- errors

    def go_offline(self, off: bool) -> None:
        """Enter bus-off, or start again."""
        if off != self.off:
            self.off = off
            self._queue_error_frame(OFF if off else RESTARTED)
        self.update_membership()

    def doubt(self, passive: bool) -> None:
        """Become error passive, or active again."""
        if passive != self.passive:
            self.passive = passive
            self._queue_error_frame(CONTROLLER, PASSIVE if passive else AGAIN_ACTIVE)

    def errors(self, count: int) -> None:
        """Report frames that were destroyed on the wire; each takes its time and gives an error frame."""
        for _ in range(count):
            self._queue_error_frame(PROTOCOL | BUS_ERROR)
        self.broken = count

    def _queue_error_frame(self, kind: int, detail: int = 0) -> None:
        if self.up and self.plugged:
            self.since = -inf
            self.inbox.append(CanMessage(ERROR | kind, bytes([0, detail, 0, 0, 0, 0, 0, 0])))
