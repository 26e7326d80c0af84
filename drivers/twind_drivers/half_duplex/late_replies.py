"""Replies that came after the reader had stopped waiting for them, matched to their requests. Pure.

A missed reply is known by id and length. A device answers in order, so a reply in time ends the wait for its
earlier ones: two devices with one id that both answer one request are not taken for late.
"""

from collections import deque
from collections.abc import Sequence

from twind_drivers.half_duplex.pending_reply import LinePacket, PendingReply

REMEMBERED = 1.0  # s after a missed reply during which a status of that device counts as late, not as foreign
KEPT = 64  # newest delays


class LateReplies:
    """Missed replies of one line. `delays` (s): from a request to its late reply, newest last."""

    def __init__(self) -> None:
        self.delays: deque[float] = deque(maxlen=KEPT)
        self._until: dict[int, float] = {}  # id -> time (s) until which its missed reply may come
        self._missed: dict[int, list[tuple[float, int]]] = {}  # id -> (time sent, data bytes), oldest first

    def __bool__(self) -> bool:
        """True while a missed reply may still come."""
        return bool(self._until)

    @property
    def ids(self) -> frozenset[int]:
        """Devices whose reply may still come."""
        return frozenset(self._until)

    def record(self, reply: PendingReply, sent: float) -> None:
        """Record which devices missed the request of time `sent` (s), and which answered it."""
        self._until = {id: until for id, until in self._until.items() if until > sent}
        oldest = sent - REMEMBERED
        self._missed = {id: [row for row in rows if row[0] > oldest] for id, rows in self._missed.items()}
        for id, answered in zip(reply.ids, reply.answered.tolist(), strict=True):
            if answered:
                self._missed.pop(id, None)
            else:
                self._until[id] = sent + REMEMBERED
                self._missed.setdefault(id, []).append((sent, reply.size))

    def measure(self, packets: Sequence[LinePacket], now: float) -> None:
        """Add the delay of each of `packets` that is a missed reply, received at the latest at `now` (s)."""
        for packet in packets:
            rows = self._missed.get(packet.id, [])
            sizes = [size for _, size in rows]
            if packet.is_status and len(packet.data) in sizes:
                place = sizes.index(len(packet.data))
                self.delays.append(now - rows[place][0])
                del rows[: place + 1]
