"""Read-only sensor on a servo bus: a block of its registers, read beside the cyclic reading. Pure.

It is no servo: it has no control table here and gets no pings. A sensor that fails repeatedly is parked:
probed ever more rarely. One whose late reply spoils a reading of the servos is parked at once.

A reply may come late, when the next one is due. After a miss each request therefore reads fewer bytes, each
time another number. Whole reads return after two replies in a row and as much time as the latest reply took,
or when the late reply has come. A late reply is recognised by its length. One case remains undetected: from a
sensor that does not reply in order, the first reply that is later than all before it.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

import numpy as np
from numpy.typing import NDArray

from twind_drivers.bus import Floats, ReadRequest, RequestReply
from twind_drivers.device_presence import FIRST, MISSES, PROBE

SHORTER = 8  # number of lengths that distinguish late replies
PROOFS = 2  # short replies in a row after which no older one is under way
# Failures within `WINDOW` s that park a sensor which replies in between. Each costs a tick the timeout, a
# parked one a balancing robot its attitude: on a machine that stalls, 3 in a second were usual.
OFTEN = 10
WINDOW = 1.0
LATE = 1.0  # s: a reply later than this counts as foreign
RAREST = 16.0  # s, longest time between probes of a sensor that spoils servo readings; it doubles up to this


@dataclass(frozen=True, slots=True)
class SensorField:
    """Field of `count` adjacent numbers at `address`. `kind`: their numpy type, such as `<i2`."""

    address: int
    kind: str
    count: int

    @property
    def end(self) -> int:
        """First address behind the field."""
        return self.address + self.count * np.dtype(self.kind).itemsize


class Sensor:
    """Request state of one sensor. Times in s."""

    def __init__(self, id: int, fields: Sequence[SensorField]) -> None:
        self.id = id
        first = min(field.address for field in fields)
        self._whole = ReadRequest((id,), first, max(field.end for field in fields) - first)
        self._parts = [(field.address - first, field.kind, field.count) for field in fields]
        most = min(SHORTER, self._whole.size - 1)
        self._short = [ReadRequest((id,), first, size) for size in range(1, most + 1)]
        self._turn = 0  # of the short ones
        self._requested: ReadRequest | None = None
        self._sent = -inf  # s, when that was
        self._owed: list[tuple[float, int]] = []  # time (s) and bytes of requests whose reply may still come
        self._proofs = 0  # short replies since the last miss
        self._longest = 0.0  # s, longest time that a late reply took
        self._failures: deque[float] = deque(maxlen=OFTEN)  # s, the last ones
        self._missed = 0  # replies in a row
        self._failed_at = -inf
        self._parked = False
        self._due = -inf  # s, of the next probe of a parked one
        self._pause = FIRST
        self._most = PROBE

    @property
    def query(self) -> ReadRequest:
        """Read of the whole block."""
        return self._whole

    @property
    def parked(self) -> bool:
        """Return True if the sensor failed repeatedly or spoilt a reading, and only probes are sent."""
        return self._parked

    def calm(self, now: float, seconds: float) -> bool:
        """Return True if the sensor has replied for `seconds` without a fault."""
        return not self._parked and now - self._failed_at >= seconds

    def ask(self, now: float) -> ReadRequest | None:
        """Return the request that is due; None: none now. `take` must follow."""
        if self._parked:
            if now < self._due:
                return None
            self._rest(now)
        self._requested = self._whole
        self._sent = now
        if self._doubts(now):
            self._requested = self._short[self._turn]
            self._turn = (self._turn + 1) % len(self._short)
        return self._requested

    def take(self, reply: RequestReply, now: float) -> list[Floats] | None:
        """Return the numbers of each field (count,), raw; None: no reply, or one to a shortened request."""
        request = self._requested
        self._requested = None
        if request is None:
            return None
        data = reply.data.get(self.id)
        if data is None or len(data) != request.size:
            self._owed.append((self._sent, request.size))
            self._proofs = 0
            self._fail(now)
            return None
        self._parked = False
        self._missed = 0
        if now - self._failed_at > max(WINDOW, self._pause):
            self._pause = FIRST
            self._most = PROBE
        if request is self._whole:
            return self._decoded(data)
        self._proofs += 1
        return None

    def late(self, size: int, now: float) -> bool:
        """Record a status of `size` bytes out of turn; return True if it replies to an earlier request."""
        for place, (sent, requested) in enumerate(self._owed):
            if requested == size:
                del self._owed[: place + 1]  # replies come in order
                self._longest = max(self._longest, min(now - sent, LATE))
                return True
        return False

    def owes(self, now: float) -> bool:
        """Return True if the reply to an earlier request may still come."""
        self._owed = [(sent, size) for sent, size in self._owed if now - sent < LATE]
        return bool(self._owed)

    def spoil(self, now: float) -> None:
        """Park the sensor at once, longer each time: its late reply cost the servos a reading."""
        self._owed.clear()
        self._most = RAREST
        self._failed_at = now
        if not self._parked:
            self._rest(now)
        self._parked = True

    def forget(self) -> None:
        """Drop expected replies after the port was closed."""
        self._requested = None
        self._parked = False
        self._missed = 0
        self._owed.clear()
        self._failures.clear()

    def _doubts(self, now: float) -> bool:
        """Return True if the reply to an earlier request may be under way."""
        if self._proofs >= PROOFS and now - self._failed_at >= self._longest:
            self._owed.clear()
        return self.owes(now)

    def _fail(self, now: float) -> None:
        self._failures.append(now)
        self._failed_at = now
        self._missed += 1
        often = len(self._failures) == OFTEN and now - self._failures[0] < WINDOW
        if (often or self._missed == MISSES) and not self._parked:
            self._parked = True
            self._rest(now)

    def _rest(self, now: float) -> None:
        self._due = now + self._pause
        self._pause = min(2.0 * self._pause, self._most)

    def _decoded(self, data: bytes) -> list[Floats]:
        return [decoded(data, at, kind, count) for at, kind, count in self._parts]


def decoded(data: bytes, at: int, kind: str, count: int) -> Floats:
    """Return `count` raw numbers (count,) from byte `at` of `data`."""
    with np.errstate(invalid="ignore"):  # a signalling NaN would raise a warning
        raw: NDArray[np.float64] = np.frombuffer(data, kind, count, at).astype(np.float64)
    return raw
