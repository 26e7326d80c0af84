"""The cyclic reading: what the next request asks of whom, and the sample that its reply makes.

Healthy: one fast (or plain) read of 10 bytes of everybody, always the same packet. After a hole: plain reads
until a reading of all who are still asked was whole.

A late answer. It carries no number of its request, so that of the last cycle looks like that of this one.
In trouble each next request therefore asks for another length of the block (`Layout.wider`): a late answer
has the wrong length and is dropped. What stays possible: an answer that is late by as many cycles as there
are lengths (9), all of them without one whole reading in between.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from twind_drivers.bus import Sample
from twind_drivers.dynamixel import packet
from twind_drivers.dynamixel.attendance import Attendance
from twind_drivers.dynamixel.layout import Layout
from twind_drivers.dynamixel.line import Exchange, Line
from twind_drivers.dynamixel.packet import CAPACITY, STATUS_OVERHEAD
from twind_drivers.dynamixel.replies import FastReply, Octets, PlainReply

ROW = np.dtype([("effort", "<i2"), ("velocity", "<i4"), ("position", "<i4")])
T = TypeVar("T", bound=np.generic)

CALM = 2  # whole plain readings in a row before the fast one is tried again


@dataclass(frozen=True, slots=True)
class Question:
    """One way of asking."""

    exchange: Exchange
    reply: PlainReply | FastReply
    before: int  # bytes that lie before the cyclic block in each answer
    fast: bool


class Cyclic:
    """The reading of m devices, whatever their layouts. `fast`: every one of them knows fast reads."""

    def __init__(self, ids: tuple[int, ...], layouts: Sequence[Layout], *, fast: bool) -> None:
        self.ids, self.fast = ids, fast
        self.attendance = Attendance(len(ids))
        self.trouble = False  # there was a hole, and not yet enough whole readings since
        self._layouts = tuple(layouts)
        most = CAPACITY // len(ids) - STATUS_OVERHEAD  # bytes of each that a reply has room for
        self._wider = [
            (before, size)
            for before, size in layouts[0].wider
            if size <= most and all((before, size) in other.wider for other in layouts)
        ]
        self._calm = self._turn = 0
        self._data: Octets | None = None
        self.rebuild()

    def block(self, place: int) -> tuple[int, int]:
        """Address and size of what is read of one device."""
        return self._layouts[place].cyclic.address, ROW.itemsize

    def rebuild(self) -> None:
        """Somebody was parked or came back: from now on those are asked who are."""
        self._places = np.flatnonzero(self.attendance.asked)
        self._all = len(self._places) == len(self.ids)
        self._quick, self._steady = (
            self._question(0, ROW.itemsize, fast=True),
            self._question(0, ROW.itemsize),
        )
        self._ring: dict[int, Question] = {}  # by turn; most are never needed
        self._now = self._steady

    def next(self) -> Exchange:
        """The request of this cycle."""
        self._now = self._troubled() if self.trouble else self._quick if self.fast else self._steady
        return self._now.exchange

    def _troubled(self) -> Question:
        if not self._wider:
            return self._steady
        self._turn = (self._turn + 1) % len(self._wider)
        if self._turn not in self._ring:
            self._ring[self._turn] = self._question(*self._wider[self._turn])
        return self._ring[self._turn]

    def sample(self, line: Line, now: float) -> Sample:
        """What the reply to the last `next` says, once the line has ended it. Zero where not heard."""
        asked, attendance = self._now, self.attendance.asked
        reply = asked.reply
        if reply.data is not self._data:
            self._data = reply.data
            rows = reply.data[:, asked.before : asked.before + ROW.itemsize].view(ROW)[:, 0]
            self._position, self._velocity, self._effort = rows["position"], rows["velocity"], rows["effort"]
        position, velocity = self._position.astype(np.int64), self._velocity.astype(np.int64)
        effort, error, heard = self._effort.astype(np.int64), reply.error, reply.heard.copy()
        if not self._all:
            position, velocity, effort = self._spread(position), self._spread(velocity), self._spread(effort)
            error, heard = self._spread(error), self._spread(heard)
        if self.trouble or not reply.whole:
            self._judge(asked, now)
        foreign, line.foreign = line.foreign, 0
        return Sample(
            sent=line.sent,
            received=line.received,
            position=position,
            velocity=velocity,
            effort=effort,
            error=error,
            heard=heard,
            asked=attendance,
            discarded=line.strays,
            foreign=foreign,
        )

    def back(self, place: int, now: float) -> None:
        """A parked device answered: it is in the next reading, which is a plain one."""
        self.attendance.back(place, now)
        self.trouble, self._calm = True, CALM
        self.rebuild()

    def _judge(self, asked: Question, now: float) -> None:
        reply = asked.reply
        if reply.whole:
            self.attendance.whole()
            self._calm -= 1
            self.trouble = self._calm > 0
            return
        self.trouble, self._calm = True, CALM
        if reply.size > ROW.itemsize and np.count_nonzero(reply.answered & ~reply.heard):
            self._wider = []  # somebody refuses the longer blocks: then late answers are not told by length
        answered, could = self._spread(reply.answered), self.attendance.asked
        if asked.fast:
            first = np.flatnonzero(could & ~answered)[:1]
            could = answered.copy()
            could[first] = True
        if self.attendance.missed(answered, could, now):
            self.rebuild()

    def _spread(self, part: NDArray[T]) -> NDArray[T]:
        """Of those who were asked -> (m,), zero for the parked."""
        full = np.zeros(len(self.ids), part.dtype)
        full[self._places] = part
        return full

    def _question(self, before: int, size: int, *, fast: bool = False) -> Question:
        """Read `size` bytes that begin `before` the cyclic block, of everybody who is asked."""
        starts = {self.ids[place]: self.block(place)[0] - before for place in self._places.tolist()}
        ids = tuple(starts)
        reply = FastReply(ids, size) if fast else PlainReply(ids, size)
        if len(set(starts.values())) == 1:
            build = packet.fast_sync_read if fast else packet.sync_read
            request = build(ids, starts[ids[0]], size)
        else:  # layouts differ: a bulk read has an address for each
            bulk = packet.fast_bulk_read if fast else packet.bulk_read
            request = bulk({id: (start, size) for id, start in starts.items()})
        return Question(Exchange(request, reply, 1 if fast else len(ids)), reply, before, fast)
