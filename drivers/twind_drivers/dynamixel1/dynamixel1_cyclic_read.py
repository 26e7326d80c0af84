"""Cyclic reading of a bus of Protocol 1.0: position, speed, load.

MX servos answer one bulk read, in which each waits for the one before it: behind a silent one nothing is
read. So the next read begins behind that one, until it is parked. AX, RX and EX get a read each, as soon as
the one before has answered.
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from twind_drivers.bus import Bools, BusSample, Ints
from twind_drivers.dynamixel1.dynamixel1_budget import SIZE
from twind_drivers.dynamixel1.dynamixel1_packet import FAULT_BITS, bulk_read
from twind_drivers.dynamixel1.dynamixel1_registers import START
from twind_drivers.flags import some
from twind_drivers.half_duplex.chained_read import chained_read
from twind_drivers.half_duplex.cyclic_read import CyclicRead, CyclicRequest
from twind_drivers.half_duplex.half_duplex_transactor import HalfDuplexTransactor, SerialTransaction
from twind_drivers.half_duplex.pending_reply import Octets, PendingReply
from twind_drivers.half_duplex.position_plausibility import PositionPlausibility

DIRECTION = 1 << 10
ALERT = 0x80
WIDEST = 14  # bytes that every model has from the present position on: up to the punch


def group_transaction(
    ids: Sequence[int], address: int, size: int, grouped: Callable[[int], bool]
) -> SerialTransaction:
    """Return the read of one block of several devices: bulk read where it exists, then single reads."""
    return chained_read(ids, address, size, grouped, bulk_read, refusals=True)


class Dynamixel1CyclicRead(CyclicRead):
    """Cyclic reading of m devices; effort is the load, a share of the largest torque."""

    def __init__(self, ids: tuple[int, ...], grouped: Mapping[int, bool], *, period: float) -> None:
        self.grouped = dict(grouped)
        self._start = 0  # place of the device that answers first
        self._plausibility = PositionPlausibility(len(ids), period)
        # A late reply is recognised by its length (`CyclicRead`): in trouble each cycle reads another one.
        super().__init__(ids, SIZE, [(0, size) for size in range(SIZE + 1, WIDEST + 1)], fast=False)

    def sample(self, line: HalfDuplexTransactor, now: float) -> BusSample:
        """Return the sample of the last request; a position that is not plausible counts as not received."""
        return self._plausibility.filter(super().sample(line, now))

    def _order(self, places: NDArray[np.intp]) -> NDArray[np.intp]:
        return np.roll(places, -int(np.searchsorted(places, self._start)))

    def _judge(self, request: CyclicRequest, answered: Bools, now: float) -> None:
        super()._judge(request, answered, now)
        start = 0
        if self.trouble:
            silent = self._places[~answered[self._places]]
            start = int(silent[0]) + 1 if silent.size else self._start
        if start != self._start:
            self._start = start
            self.rebuild()

    def _make_request(self, before: int, size: int, *, fast: bool = False) -> CyclicRequest:
        ids = [self.ids[place] for place in self._places.tolist()]
        transaction = group_transaction(ids, START, size, self.grouped.__getitem__)
        assert transaction.reply is not None
        return CyclicRequest(transaction, transaction.reply, before, fast=len(ids) > 1)

    def _decode(self, request: CyclicRequest) -> tuple[Ints, Ints, Ints]:
        words = np.ascontiguousarray(request.reply.data[:, :SIZE]).view("<u2").astype(np.int64)
        position, velocity, load = words.T
        return position, _signed(velocity), _signed(load)

    def _errors(self, reply: PendingReply) -> Octets:
        error = reply.error
        return np.where(error & FAULT_BITS, ALERT, 0).astype(np.uint8) if some(error) else error

    def _refusing(self, reply: PendingReply) -> np.ndarray:
        refusing: np.ndarray = reply.answered & ~reply.heard
        return refusing


def _signed(words: Ints) -> Ints:
    """Decode direction and magnitude; other bits are none of the number."""
    size = words & (DIRECTION - 1)
    return np.where(words & DIRECTION, -size, size)
