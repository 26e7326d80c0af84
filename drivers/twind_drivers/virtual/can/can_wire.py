"""CAN wire: order of frames by arbitration. A frame without acknowledging receiver waits.

Senders are the host's adapter (`HOST`) and nodes by their row. Each has a queue of its own that keeps its
order, as a controller with one mailbox does: only heads compete. A frame occupies the wire for its own bits,
stuff bits counted.
"""

from collections import deque
from collections.abc import Callable
from math import inf
from typing import NamedTuple

from twind_drivers.virtual.can.can_message import SHORTEST, CanMessage, bits, rank

HOST = -1
REMEMBERED = 4096  # frames whose bits are counted already
MAILBOX = 8  # frames that a node keeps while it cannot send; later ones are lost (assumed)


class QueuedFrame(NamedTuple):
    """A frame that its sender wants to send from `ready` (s) on."""

    ready: float
    rank: int
    message: CanMessage


class FrameInFlight(NamedTuple):
    """The frame that is on the wire next, its sender, and its end, s."""

    end: float
    sender: int
    message: CanMessage


class CanWire:
    """Waiting frames, and the order in which the wire carries them.

    `heard(sender)`: True when another controller is there to acknowledge, so that the sender may send.
    """

    def __init__(self, bitrate: int, listener: Callable[[int], bool], *, timing: bool) -> None:
        self.bitrate = bitrate
        self.timing = timing
        self._heard = listener
        self._free = -inf  # s, when the wire is idle
        self._queues: dict[int, deque[QueuedFrame]] = {}
        self._next: FrameInFlight | None = None
        self._known = True  # is `_next` up to date?
        self._spans: dict[CanMessage, float] = {}

    def put(self, sender: int, message: CanMessage, ready: float) -> bool:
        """Queue a frame. False: a node's mailbox is full, and the frame lost."""
        queue = self._queues.setdefault(sender, deque())
        if sender != HOST and len(queue) >= MAILBOX:
            return False
        queue.append(QueuedFrame(ready, rank(message.id), message))
        self._known = False
        return True

    def count(self, sender: int) -> int:
        """Return the number of frames of this sender that have not left."""
        return len(self._queues.get(sender, ()))

    def drop(self, sender: int) -> None:
        """Drop all frames of this sender."""
        self._queues.pop(sender, None)
        self._known = False

    def update_membership(self, now: float) -> None:
        """Update after a sender came or went: frames that could not be sent may go from `now` on."""
        self._free = max(self._free, now)
        self._known = False

    def noise(self, now: float, spent: float) -> None:
        """Occupy the wire with garbage for this long, s."""
        self.update_membership(now)
        self._free += spent if self.timing else 0.0

    def next(self) -> FrameInFlight | None:
        """Return the frame that is sent next; None: no sender may send."""
        if not self._known:
            self._next = self._pick()
            self._known = True
        return self._next

    def take(self) -> FrameInFlight | None:
        """Remove the next frame, which has passed the wire."""
        sent = self.next()
        if sent is not None:
            queue = self._queues[sent.sender]
            queue.popleft()
            if not queue:
                del self._queues[sent.sender]
            self._free = sent.end
            self._known = False
        return sent

    def soonest_answer(self) -> float:
        """Return the least time (s) that any answer takes."""
        return SHORTEST / self.bitrate if self.timing else 0.0

    def _pick(self) -> FrameInFlight | None:
        heads = [
            (queue[0], sender) for sender, queue in self._queues.items() if queue and self._heard(sender)
        ]
        if not heads:
            return None
        if len(heads) == 1:
            first, sender = heads[0]
            start = max(self._free, first.ready)
        else:
            start = max(self._free, min([head.ready for head, _ in heads]))
            able = [(head.rank, sender, head) for head, sender in heads if head.ready <= start]
            _, sender, first = min(able)
        return FrameInFlight(start + self._span(first.message), sender, first.message)

    def _span(self, message: CanMessage) -> float:
        """Return the time (s) on the wire; cached, since a robot that holds repeats the same frames."""
        if not self.timing:
            return 0.0
        span = self._spans.get(message)
        if span is None:
            if len(self._spans) >= REMEMBERED:
                self._spans.clear()
            span = self._spans[message] = bits(message) / self.bitrate
        return span
