"""Timing of bytes on a half-duplex wire: 10 bits a byte, one packet after the other (8N1)."""

from bisect import insort
from collections import deque
from collections.abc import Sequence
from itertools import accumulate
from math import inf
from typing import NamedTuple

from twind_drivers.virtual.uart_receiver import clash

BITS = 10  # per byte: start, 8 data, stop


class ReplyBurst(NamedTuple):
    """Answer to one request: `data`, cut where each device's share ends; each share ends at its own time."""

    start: float  # s
    ends: Sequence[float]  # s after `start`, ascending
    cuts: Sequence[int]  # bytes, ascending; the last is len(data)
    data: bytes
    taken: int = 0  # bytes handed over already


class OutOfTurnBytes(NamedTuple):
    """Bytes on the wire apart from the order of answers; sorted by their end."""

    end: float  # s, when the last byte has come
    start: float  # s
    data: bytes


class HalfDuplexWire:
    """Bytes under way on one line. With `timing` off, every byte arrives at once.

    Collisions happen on order only (`collide`): bytes that the host sends while a reply is under way go out
    after it. So a host whose bytes were read late (a loaded machine) is served late, not garbled.
    """

    def __init__(self, baud: int, *, timing: bool = True) -> None:
        self.baud = baud
        self.timing = timing
        self.lag = 0.0  # s, added to every answer (a fault on order)
        self._free = -inf  # s, when the wire is silent
        self._bursts: deque[ReplyBurst] = deque()
        self._loose: list[OutOfTurnBytes] = []  # out of turn, by their end

    def span(self, size: int) -> float:
        """Return the seconds that `size` bytes take."""
        return size * BITS / self.baud if self.timing else 0.0

    def schedule_request(self, size: int, now: float) -> float:
        """Take `size` bytes from the host at `now`; return when the last of them has arrived, s."""
        self._free = max(self._free, now) + self.span(size)
        return self._free

    def ends(self, delays: Sequence[float], sizes: Sequence[int]) -> list[float]:
        """Return the end of each of some answers, s after the request: each after its return delay (s)."""
        if not self.timing:
            return [0.0] * len(sizes)
        return list(accumulate(d + self.span(size) for d, size in zip(delays, sizes, strict=True)))

    def schedule_replies(self, ends: Sequence[float], cuts: Sequence[int], data: bytes) -> None:
        """Queue the devices' answer to the last request that the wire received."""
        self._bursts.append(ReplyBurst(self._free + self.lag, ends, cuts, data))
        self._free += ends[-1]

    def next_output_time(self) -> float:
        """Return when the first answer under way is complete, s; `inf`: none is."""
        first = self._bursts[0].start + self._bursts[0].ends[-1] if self._bursts else inf
        return min(first, self._loose[0].end) if self._loose else first

    def take(self, now: float) -> bytes:
        """Return the bytes whose time has come: whole answers, and of one that is cut short whole shares."""
        if self._loose:
            return self._take_loose(now)
        out = b""
        while self._bursts:
            burst = self._bursts[0]
            if burst.start + burst.ends[-1] <= now:
                out += burst.data[burst.taken :]
                self._bursts.popleft()
                continue
            come = sum(burst.start + end <= now for end in burst.ends)
            upto = burst.cuts[come - 1] if come else 0
            if upto > burst.taken:
                out += burst.data[burst.taken : upto]
                self._bursts[0] = burst._replace(taken=upto)
            break
        return out

    def clear(self) -> None:
        """Drop everything under way."""
        self._bursts.clear()
        self._loose.clear()
        self._free = -inf

    # ------------------------------------------------------------------------------------- out of turn

    def free_at(self, now: float) -> float:
        """Return when the host may send without meeting an answer, s."""
        return max(self._free, now)

    def occupy(self, until: float) -> None:
        """Occupy the line until then, s."""
        self._free = max(self._free, until)

    def interject(self, end: float, data: bytes) -> None:
        """Send bytes that delay no other sender; the last of them arrives at `end`, s."""
        if data:
            insort(self._loose, OutOfTurnBytes(end, end - self.span(len(data)), data))

    def collide(self, start: float, data: bytes) -> bytes | None:
        """Send bytes from `start` (s) on, over any other sender; return the bytes received from the overlap.

        Answers then under way arrive garbled. None: no other sender was active. Without timing nothing
        overlaps.
        """
        self._loosen()
        end = start + self.span(len(data))
        met = [each for each in self._loose if each.start < end and start < each.end]
        self._free = start
        if not met:
            return None
        received = clash([(start, data), *((each.start, each.data) for each in met)], self.baud)
        self._loose = [each for each in self._loose if each not in met]
        self.interject(max(end, *(each.end for each in met)), received)
        return received

    def _loosen(self) -> None:
        """Split every answer under way into shares of their own."""
        for burst in self._bursts:
            cuts = [0, *burst.cuts]
            for end, first, last in zip(burst.ends, cuts, cuts[1:], strict=False):
                self.interject(burst.start + end, burst.data[max(first, burst.taken) : last])
        self._bursts.clear()

    def _take_loose(self, now: float) -> bytes:
        self._loosen()
        count = sum(each.end <= now for each in self._loose)
        out = b"".join(each.data for each in self._loose[:count])
        del self._loose[:count]
        return out
