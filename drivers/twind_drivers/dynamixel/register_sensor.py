"""A device on a servo bus that only tells: a block of its registers, read beside the cyclic reading. Pure.

It is no servo: it has no control table of ours, nobody pings it. One that fails again and again is parked:
probed ever more rarely. So is, at once, one whose late answer spoilt a reading of the servos.

An answer may come late, when the next one is due. So after a miss it is asked for fewer bytes, each time
another number, until two were answered in a row and as much time has passed as the latest answer took; or the
late answer itself came. A late one is known by its length. What this cannot tell: of a device that does not
answer in order, the first answer that is later than all before it.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

import numpy as np
from numpy.typing import NDArray

from twind_drivers.bus import Floats, ReadRequest, RequestReply
from twind_drivers.device_presence import FIRST, MISSES, PROBE

SHORTER = 8  # so many lengths are told apart
PROOFS = 2  # short answers in a row: after them nothing older is under way
WINDOW = 1.0  # s: `MISSES` failures in so long, and it is parked
LATE = 1.0  # s that an answer may be late and is still known as one
RAREST = (
    16.0  # s between probes of one that spoils readings of the servos; twice as long each time until then
)


@dataclass(frozen=True, slots=True)
class SensorField:
    """`count` numbers side by side at `address`; `kind` as numpy spells it: `<i2`."""

    address: int
    kind: str
    count: int

    @property
    def end(self) -> int:
        """The address behind the last."""
        return self.address + self.count * np.dtype(self.kind).itemsize


class Sensor:
    """One device. Times in s."""

    def __init__(self, id: int, fields: Sequence[SensorField]) -> None:
        self.id = id
        first = min(field.address for field in fields)
        self._whole = ReadRequest((id,), first, max(field.end for field in fields) - first)
        self._parts = [(field.address - first, field.kind, field.count) for field in fields]
        most = min(SHORTER, self._whole.size - 1)
        self._short = [ReadRequest((id,), first, size) for size in range(1, most + 1)]
        self._turn = 0  # of the short ones
        self._asked: ReadRequest | None = None
        self._sent = -inf
        self._owed: list[tuple[float, int]] = []  # s and bytes of questions that may still be answered
        self._proofs = PROOFS
        self._longest = 0.0  # s that an answer took, of those that came late
        self._failures: deque[float] = deque(maxlen=MISSES)  # s, the last ones
        self._failed_at = -inf
        self._parked = False
        self._due = -inf
        self._pause = FIRST
        self._most = PROBE

    @property
    def query(self) -> ReadRequest:
        """The whole block."""
        return self._whole

    @property
    def parked(self) -> bool:
        """It failed again and again, or spoilt a reading, and is probed only."""
        return self._parked

    def calm(self, now: float, seconds: float) -> bool:
        """It has answered for so long, and nothing was wrong."""
        return not self._parked and now - self._failed_at >= seconds

    def ask(self, now: float) -> ReadRequest | None:
        """What to ask now; None: it is left alone for a while. `take` must follow."""
        if self._parked:
            if now < self._due:
                return None
            self._rest(now)
        self._asked = self._whole
        self._sent = now
        if self._doubts(now):
            self._asked = self._short[self._turn]
            self._turn = (self._turn + 1) % len(self._short)
        return self._asked

    def take(self, reply: RequestReply, now: float) -> list[Floats] | None:
        """The numbers of each field, raw; None: it did not answer, or answered to less than all."""
        asked = self._asked
        self._asked = None
        if asked is None:
            return None
        data = reply.data.get(self.id)
        if data is None or len(data) != asked.size:
            self._owed.append((self._sent, asked.size))
            self._proofs = 0
            self._fail(now)
            return None
        self._parked = False
        if now - self._failed_at > max(WINDOW, self._pause):
            self._pause = FIRST
            self._most = PROBE
        if asked is self._whole:
            self._proofs = PROOFS
            return self._decoded(data)
        self._proofs += 1
        return None

    def late(self, size: int, now: float) -> bool:
        """Its status of `size` bytes came out of its turn; True: it is the answer to an earlier question."""
        for place, (sent, asked) in enumerate(self._owed):
            if asked == size:
                del self._owed[: place + 1]  # answers come in their order
                self._longest = max(self._longest, min(now - sent, LATE))
                return True
        return False

    def owes(self, now: float) -> bool:
        """A question was not answered, and may still be."""
        self._owed = [(sent, size) for sent, size in self._owed if now - sent < LATE]
        return bool(self._owed)

    def spoil(self, now: float) -> None:
        """Its late answer cost the servos a reading: parked at once, for longer each time."""
        self._owed.clear()
        self._most = RAREST
        self._failed_at = now
        if not self._parked:
            self._rest(now)
        self._parked = True

    def forget(self) -> None:
        """The port was closed: nothing is on its way any more."""
        self._asked = None
        self._proofs = PROOFS
        self._parked = False
        self._owed.clear()
        self._failures.clear()

    def _doubts(self, now: float) -> bool:
        """The answer to an earlier question may be on its way."""
        if self._proofs >= PROOFS and now - self._failed_at >= self._longest:
            self._owed.clear()
        return self.owes(now)

    def _fail(self, now: float) -> None:
        self._failures.append(now)
        self._failed_at = now
        often = len(self._failures) == MISSES and now - self._failures[0] < WINDOW
        if often and not self._parked:
            self._parked = True
            self._rest(now)

    def _rest(self, now: float) -> None:
        self._due, self._pause = now + self._pause, min(2.0 * self._pause, self._most)

    def _decoded(self, data: bytes) -> list[Floats]:
        return [decoded(data, at, kind, count) for at, kind, count in self._parts]


def decoded(data: bytes, at: int, kind: str, count: int) -> Floats:
    """`count` numbers from byte `at` of `data` on, raw."""
    with np.errstate(invalid="ignore"):  # a NaN may signal
        raw: NDArray[np.float64] = np.frombuffer(data, kind, count, at).astype(np.float64)
    return raw
