"""How long a way out has been blocked, and what that means: congestion, a dead line, a lost port. Pure.

A healthy queue is through in some 65 ms (512 frames at 1 Mbit/s), so what is full for a second is dead:
nobody acknowledges, the controller is off the wire, or the adapter hangs. Shorter, and frames are dropped.
"""

from math import inf

from twind_drivers.bus import PortError, PortFault
from twind_drivers.can.channel import CanChannelStatus, CanErrorState

DEAF = 0.1  # s of refusals and of silence: nobody is there to acknowledge
DEAD = 1.0  # s of refusals
REMEDY = "are the actuators powered, the wires right and terminated, the bit rate theirs?"


def queue_full(port: str, taken: int, count: int) -> PortError:
    """Build the error for a queue that took `taken` of `count` frames. The rest was dropped."""
    reason = f"the queue was full after {taken} of {count} frames, the rest was dropped: {REMEDY}"
    return PortError(port, reason, PortFault.OUTPUT_FULL)


class TransmitStall:
    """Refusals of one way out: since when, and whether anybody was heard meanwhile."""

    def __init__(self) -> None:
        self._since = self._last = -inf
        self._heard = -inf
        self._emptied = False  # the queue has been thrown away, so that it takes something says nothing
        self.blocked = False  # refused so long, and nobody heard, that the line counts as off

    @property
    def is_blocked(self) -> bool:
        """Something was refused, and nothing has been taken since."""
        return self._last > -inf

    def record_refusal(self, now: float) -> float:
        """Something was not taken. How long (s) nothing has been; a refusal a second ago is another story."""
        if now - self._last > DEAD:
            self._since = now
        self._last = now
        self.blocked = now - max(self._since, self._heard) >= DEAF
        return now - self._since

    def emptied(self) -> None:
        """The queue was thrown away: until somebody is heard, what it takes has not left."""
        self._emptied = True

    def record_acceptance(self) -> None:
        """The queue took something, so something had left it, unless it was emptied."""
        if self._emptied:
            return
        self._since = self._last = -inf
        self.blocked = False

    def record_reception(self, now: float) -> None:
        """Somebody spoke on the wire: there is one who acknowledges."""
        self._heard = now
        self._emptied = self.blocked = False


class ChannelStatusTracker:
    """What was told of the line, and what refusals say of it, as one `CanChannelStatus`."""

    def __init__(self, condition: CanChannelStatus) -> None:
        self.condition = condition
        self.stall = TransmitStall()
        self._told = CanErrorState.ACTIVE

    def record_status(self, line: CanErrorState) -> None:
        """By an error frame, or by the adapter's flags."""
        self._told = line
        self.settle()

    def settle(self) -> None:
        """The worse of both."""
        self.condition.line = CanErrorState.OFF if self.stall.blocked else self._told


def dead(port: str, waited: float) -> PortError:
    """Lost: a way out that has taken nothing for `waited` s."""
    return PortError(port, f"has taken nothing for {waited:.1f} s: {REMEDY}", kind=PortFault.LOST)
