"""Time that a CAN transmit queue has been blocked: congestion, a dead line, a lost port. Pure.

A healthy queue of 512 frames at 1 Mbit/s empties in some 65 ms (read: axol). One that is full for a second is
dead: no node acknowledges, the controller is off the wire, or the adapter hangs. Frames refused for less time
are dropped as congestion.
"""

from math import inf

from twind_drivers.bus import PortError, PortErrorCause
from twind_drivers.ports.channel import CanChannelStatus, CanErrorState

DEAF = 0.1  # s of refusals and silence: no node acknowledges; the actuators' watchdogs have run out then
DEAD = 1.0  # s of refusals after which the port counts as lost; congestion ends within 65 ms
REMEDY = "check the power of the actuators, the wiring and its termination, and the bit rate"


def queue_full(port: str, taken: int, count: int) -> PortError:
    """Build the error for a queue that took `taken` of `count` frames. The rest was dropped."""
    reason = f"the queue was full after {taken} of {count} frames, the rest was dropped: {REMEDY}"
    return PortError(port, reason, PortErrorCause.OUTPUT_FULL)


class TransmitStall:
    """Refusals of one transmit queue: their start, and receptions meanwhile."""

    def __init__(self) -> None:
        self._since = self._last = -inf
        self._received_at = -inf
        self._emptied = False  # the queue was discarded: that it accepts frames proves nothing then
        self.blocked = False  # refusals without reception for so long that the line counts as off

    @property
    def is_blocked(self) -> bool:
        """Return True if a frame was refused and none accepted since."""
        return self._last > -inf

    def record_refusal(self, now: float) -> float:
        """Record a refusal; return the time (s) of refusals. A pause of a second starts it anew."""
        if now - self._last > DEAD:
            self._since = now
        self._last = now
        self.blocked = now - max(self._since, self._received_at) >= DEAF
        return now - self._since

    def emptied(self) -> None:
        """Record that the queue was discarded: until a reception, accepted frames prove nothing."""
        self._emptied = True

    def record_acceptance(self) -> None:
        """Record that the queue accepted a frame: an earlier one has left, unless the queue was emptied."""
        if self._emptied:
            return
        self._since = self._last = -inf
        self.blocked = False

    def record_reception(self, now: float) -> None:
        """Record a received frame: there is a node that acknowledges."""
        self._received_at = now
        self._emptied = self.blocked = False


class ChannelStatusTracker:
    """Status of a line from its reports and refusals, as one `CanChannelStatus`."""

    def __init__(self, condition: CanChannelStatus) -> None:
        self.condition = condition
        self.stall = TransmitStall()
        self._reported = CanErrorState.ACTIVE

    def record_status(self, line: CanErrorState) -> None:
        """Record the state from an error frame or from the adapter's flags."""
        self._reported = line
        self.settle()

    def settle(self) -> None:
        """Set the worse of the reported state and the state from refusals."""
        self.condition.line = CanErrorState.OFF if self.stall.blocked else self._reported


def dead(port: str, waited: float) -> PortError:
    """Lost: a way out that has accepted nothing for `waited` s."""
    return PortError(port, f"has accepted nothing for {waited:.1f} s: {REMEDY}", kind=PortErrorCause.LOST)
