"""Cyclic reading of a bus of XL-320 or PRO -R: one sync read of position, speed and effort."""

import numpy as np

from twind_drivers.bus import Bools, Ints, ReadRequest
from twind_drivers.dynamixel.dynamixel_cyclic_read import REFUSALS
from twind_drivers.dynamixel2_unwatched.unwatched_packets import plain_transaction
from twind_drivers.dynamixel2_unwatched.unwatched_registers import UnwatchedLayout
from twind_drivers.half_duplex.cyclic_read import CyclicRead, CyclicRequest
from twind_drivers.half_duplex.pending_reply import PendingReply

DIRECTION = 1 << 10  # bit of speed and load of an XL-320


class UnwatchedCyclicRead(CyclicRead):
    """Cyclic reading of m devices of one layout."""

    def __init__(self, ids: tuple[int, ...], layout: UnwatchedLayout) -> None:
        self._start = layout.start
        self._row = layout.row
        self._by_direction = layout.row["velocity"] == np.uint16
        super().__init__(ids, layout.row.itemsize, layout.wider, fast=False)

    def _make_request(self, before: int, size: int, *, fast: bool = False) -> CyclicRequest:
        ids = tuple(self.ids[place] for place in self._places.tolist())
        transaction = plain_transaction(ReadRequest(ids, self._start - before, size))
        assert transaction.reply is not None
        return CyclicRequest(transaction, transaction.reply, before, fast=False)

    def _decode(self, request: CyclicRequest) -> tuple[Ints, Ints, Ints]:
        data = request.reply.data[:, request.before : request.before + self._row.itemsize]
        rows = np.ascontiguousarray(data).view(self._row)[:, 0]
        position, velocity, effort = (rows[name].astype(np.int64) for name in self._row.names or ())
        if self._by_direction:
            return position, _signed(velocity), _signed(effort)
        return position, velocity, effort

    def _refusing(self, reply: PendingReply) -> Bools:
        return reply.answered & ~reply.heard & np.isin(reply.error & 0x7F, REFUSALS)


def _signed(words: Ints) -> Ints:
    size = words & (DIRECTION - 1)
    return np.where(words & DIRECTION, -size, size)
