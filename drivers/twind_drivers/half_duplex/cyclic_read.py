"""Cyclic reading: the request of each cycle and the sample made from its reply.

Healthy: one fast (or plain) read of 10 bytes from every device, always the same packet. After a missing
answer: plain reads until a reading of all devices still in it was whole.

Late answers. An answer carries no number of its request, so one of the last cycle has the form of one of this
cycle. In trouble each next request therefore reads another length of the block (`wider` of the layout): a
late answer has the wrong length and is dropped. Answers of one device come in order. If it answers with a
length not used since its last answer, nothing older is under way. All lengths are then free again for it.

Nine cycles without its answer use up all lengths. A device that answers with a length used meanwhile is a
suspect. Its readings are dropped until three of its answers in a row came in time with no stray byte around.
A pile of late answers has strays. A steady delay meets the lengths in another order, as that changes from
turn to turn; it is the same again after six turns. Two errors stay possible: a steady delay of 54 cycles, and
an answer some tens of cycles late. The latter needs a pile that ends in three windows without stray bytes,
each in the length just requested.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import gcd
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from twind_drivers.bus import Bools, BusSample, Ints
from twind_drivers.device_presence import DevicePresence
from twind_drivers.flags import some
from twind_drivers.half_duplex.half_duplex_transactor import HalfDuplexTransactor, SerialTransaction
from twind_drivers.half_duplex.pending_reply import Octets, PendingReply

T = TypeVar("T", bound=np.generic)
REFUSED = 3  # refusals in a row after which longer blocks are not requested; one bit error can forge one

SURE = 3  # replies in a row without stray bytes that clear a suspect; fewer could all be late replies
CALM = 2  # whole plain readings in a row before the next fast one, which a still missing device would break


@dataclass(frozen=True, slots=True)
class CyclicRequest:
    """Cyclic request of one length and kind."""

    exchange: SerialTransaction
    reply: PendingReply
    before: int  # bytes that lie before the cyclic block in each answer
    fast: bool


class CyclicRead:
    """Cyclic reading of m devices; a family decodes its rows and makes its requests.

    `fast`: every device supports fast reads.
    """

    def __init__(
        self, ids: tuple[int, ...], size: int, wider: Sequence[tuple[int, int]], *, fast: bool
    ) -> None:
        """Make the reading of `size` bytes of each device.

        `wider`: longer blocks that every device has: bytes before the cyclic block, bytes of the whole.
        """
        self.ids = ids
        self.fast = fast
        self.attendance = DevicePresence(len(ids))
        self.hasty = False  # a plain reading of all devices does not fit a cycle
        self.trouble = False  # a reply was missing, and fewer than `CALM` whole readings followed
        self._size = size
        self._wider = list(wider)
        # In trouble, (m,): True where the last reply belongs to the last request.
        self.proven: Bools = np.ones(len(ids), np.bool_)
        self._calm = self._turn = 0
        self._refused = 0  # longer blocks in a row that a device refused
        self._cycle = 0
        self._proven_at = np.zeros(len(ids), np.int64)  # (m,) cycle of each device's last proven reply
        self._clean = np.zeros(len(ids), np.int64)  # (m,) readings in a row with its reply and no stray byte
        self._used_at: dict[int, int] = {}  # place of a length in the ring -> cycle of its last request
        self._before = 0  # cycle in which the present length was requested before
        self.rebuild()

    def hasten(self, on: bool) -> None:
        """Use fast reads in trouble as well (`on`), since plain answers take longer than a cycle."""
        if on is not self.hasty:
            self.hasty = on
            self.rebuild()

    def begin_anew(self) -> None:
        """Start again after a pause in which all replies have arrived: every device is read as at first."""
        self.attendance = DevicePresence(len(self.ids))
        self.trouble = False
        self._calm = 0
        self.rebuild()

    def rebuild(self) -> None:
        """Rebuild the requests after a device was parked or came back: they go to the devices not parked."""
        self._places = self._order(np.flatnonzero(self.attendance.asked))
        self._all = np.array_equal(self._places, np.arange(len(self.ids)))
        self._quick = self._make_request(0, self._size, fast=True)
        self._steady = self._make_request(0, self._size)
        self._ring: dict[int, CyclicRequest] = {}  # by turn; most are never needed
        self._now = self._steady

    def next(self) -> SerialTransaction:
        """Return the request of this cycle."""
        self._cycle += 1
        self._now = self._troubled() if self.trouble else self._quick if self.fast else self._steady
        return self._now.exchange

    def _troubled(self) -> CyclicRequest:
        count = len(self._wider)
        if not count:
            return self._quick if self.hasty else self._steady
        self._turn += 1
        turn, place = divmod(self._turn, count)
        steps = [step for step in range(1, count) if gcd(step, count) == 1] or [1]
        which = place * steps[turn % len(steps)] % count
        self._before = self._used_at.get(which, 0)
        self._used_at[which] = self._cycle
        if which not in self._ring:
            self._ring[which] = self._make_request(*self._wider[which], fast=self.hasty)
        return self._ring[which]

    def sample(self, line: HalfDuplexTransactor, now: float) -> BusSample:
        """Return the sample from the reply to the last `next`, once the line has ended it.

        Values are 0 for devices without a proven reply.
        """
        request = self._now
        requested = self.attendance.asked  # (m,)
        reply = request.reply
        position, velocity, effort = self._decode(request)
        error = self._errors(reply)
        fresh = reply.heard.copy()
        if not self._all:
            position = self._scatter_to_devices(position)
            velocity = self._scatter_to_devices(velocity)
            effort = self._scatter_to_devices(effort)
            error = self._scatter_to_devices(error)
            fresh = self._scatter_to_devices(fresh)
        if self.trouble or not reply.whole:
            answered = reply.answered if self._all else self._scatter_to_devices(reply.answered)
            fresh = fresh & self._prove(answered, line.strays)
            self._judge(request, answered, now)
        foreign = line.foreign
        line.foreign = 0
        late: tuple[int, ...] = ()
        if line.late:
            late = tuple(line.late)
            line.late = []
        return BusSample(
            sent=line.sent,
            received=line.received,
            position=position,
            velocity=velocity,
            effort=effort,
            error=error,
            heard=fresh,
            asked=requested,
            discarded=line.strays,
            foreign=foreign,
            effort_told=self._effort_mask(fresh, request),
            late=late,
        )

    def back(self, place: int, now: float) -> None:
        """Take back a parked device that answered: it is in the next reading, which is a plain one."""
        self.attendance.back(place, now)
        self.trouble = True
        self._calm = CALM
        self.rebuild()

    def _prove(self, answered: Bools, strays: int) -> Bools:
        """Return a mask (m,) of the devices whose answer is to this request, not a late one.

        An answer is proven in a length of which none can be under way, or after `SURE` clean readings in a
        row.
        """
        if not self.trouble:  # the first missing reply: in the cycle before, all devices not parked replied
            self._proven_at[self._places] = self._cycle - 1
            self._before = 0
        self._clean = np.where(answered & (strays == 0), self._clean + 1, 0)
        suspect = (self._before > self._proven_at) & bool(self._wider)
        self.proven = answered & (~suspect | (self._clean >= SURE))
        self._proven_at[self.proven] = self._cycle
        return self.proven

    def _judge(self, request: CyclicRequest, answered: Bools, now: float) -> None:
        reply = request.reply
        could = self.attendance.asked
        if reply.whole:
            if not some(could & ~self.proven):
                self.attendance.record_complete_reply()
                self._calm -= 1
                self.trouble = self._calm > 0
            return
        self.trouble = True
        self._calm = CALM
        if reply.size > self._size:
            # Repeated refusals only: one bit error can make such a reply, too.
            self._refused = self._refused + 1 if some(self._refusing(reply)) else 0
            if self._refused >= REFUSED:
                self._wider = []  # without longer blocks late replies cannot be recognised by their length
        if request.fast:  # the chain ends at the first missing device: those behind it cannot reply
            first = self._places[(could & ~answered)[self._places]][:1]
            could = answered.copy()
            could[first] = True
        if self.attendance.record_missing_reply(answered, could, now):
            self.rebuild()

    def _scatter_to_devices(self, part: NDArray[T]) -> NDArray[T]:
        """Expand values of the devices in the request to (m,), with zero for the parked ones."""
        full = np.zeros(len(self.ids), part.dtype)
        full[self._places] = part
        return full

    # ------------------------------------------------------------------------- what a family answers

    def _order(self, places: NDArray[np.intp]) -> NDArray[np.intp]:
        """Return the devices in the order in which they are to answer."""
        return places

    def _make_request(self, before: int, size: int, *, fast: bool = False) -> CyclicRequest:
        """Read `size` bytes from `before` bytes ahead of the cyclic block, of every device not parked."""
        raise NotImplementedError

    def _decode(self, request: CyclicRequest) -> tuple[Ints, Ints, Ints]:
        """Return position, velocity and effort of each device in the request."""
        raise NotImplementedError

    def _errors(self, reply: PendingReply) -> Octets:
        """Return the error byte of each reply, bit 7 as alert."""
        return reply.error

    def _effort_mask(self, fresh: Bools, request: CyclicRequest) -> Bools | None:
        """Return the devices that reported an effort; None: all that are `fresh`."""
        return None

    def _refusing(self, reply: PendingReply) -> Bools:
        """Return the devices that report that they lack the block."""
        return ~reply.answered & False
