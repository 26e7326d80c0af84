"""Cyclic reading of a Feetech bus: position, speed, load, and where there is room the current.

A servo without sync read gets a read of its own, as soon as the one before has answered. Behind a silent one
of those nothing is read in that cycle, until it is parked.
"""

from collections.abc import Callable, Sequence

import numpy as np

from twind_drivers.bus import Bools, BusSample, Ints
from twind_drivers.feetech.feetech_budget import SHORT, WHOLE
from twind_drivers.feetech.feetech_packet import FAULT_BITS, sync_read
from twind_drivers.feetech.feetech_registers import RegisterMap
from twind_drivers.flags import some
from twind_drivers.half_duplex.chained_read import chained_read
from twind_drivers.half_duplex.cyclic_read import CyclicRead, CyclicRequest
from twind_drivers.half_duplex.half_duplex_transactor import HalfDuplexTransactor, SerialTransaction
from twind_drivers.half_duplex.pending_reply import Octets, PendingReply
from twind_drivers.half_duplex.position_plausibility import PositionPlausibility

START = 56  # present position
ALERT = 0x80


def group_transaction(
    ids: Sequence[int], address: int, size: int, grouped: Callable[[int], bool]
) -> SerialTransaction:
    """Return the read of one block of several devices: sync read where it exists, then single reads."""
    return chained_read(ids, address, size, grouped, sync_read)


class FeetechCyclicRead(CyclicRead):
    """Cyclic reading of m devices: effort is the current where a device has one, else the PWM duty.

    `whole`: the block is long enough for the current; else no effort is reported where it is a current.
    """

    def __init__(
        self, ids: tuple[int, ...], maps: Sequence[RegisterMap], *, currents: bool, whole: bool, period: float
    ) -> None:
        self.currents = currents
        self.grouped = {id: each.sync_read for id, each in zip(ids, maps, strict=True)}
        self._big_endian = np.array([each.big_endian for each in maps])
        self._plausibility = PositionPlausibility(len(ids), period)
        # A late reply is recognised by its length (`CyclicRead`): in trouble each cycle reads another one.
        size = WHOLE if whole else SHORT
        lengths = range(SHORT + 1, WHOLE if whole else SHORT + 6)
        super().__init__(ids, size, [(0, length) for length in lengths], fast=False)

    def set_maps(self, maps: Sequence[RegisterMap], grouped: Sequence[bool]) -> None:
        """Take over what identification found: (m) maps, and which devices answer sync reads."""
        self._big_endian = np.array([each.big_endian for each in maps])
        self.grouped = dict(zip(self.ids, grouped, strict=True))
        self.rebuild()

    def sample(self, line: HalfDuplexTransactor, now: float) -> BusSample:
        """Return the sample of the last request; a position that is not plausible counts as not received."""
        return self._plausibility.filter(super().sample(line, now))

    def _make_request(self, before: int, size: int, *, fast: bool = False) -> CyclicRequest:
        ids = [self.ids[place] for place in self._places.tolist()]
        transaction = group_transaction(ids, START, size, self.grouped.__getitem__)
        assert transaction.reply is not None
        return CyclicRequest(transaction, transaction.reply, before, fast=bool(transaction.then))

    def _decode(self, request: CyclicRequest) -> tuple[Ints, Ints, Ints]:
        reply = request.reply
        words = self._words(reply.data[:, :6])
        position, velocity, load = words.T
        _sign(position, 15)
        _sign(velocity, 15)
        effort = load
        if not self.currents:
            _sign(effort, 10)
        elif reply.size >= WHOLE:
            effort = self._words(reply.data[:, 13:15])[:, 0]
            _sign(effort, 15)
        else:
            effort = np.zeros_like(position)
        return position, velocity, effort

    def _words(self, data: Octets) -> Ints:
        """Return the words (k, w) in `data` (k, 2 w), each in the byte order of its device."""
        words = data.view("<u2")
        if self._big_endian.any():
            words = np.where(self._big_endian[self._places][:, None], words.byteswap(), words)
        return words.astype(np.int64)

    def _errors(self, reply: PendingReply) -> Octets:
        error = reply.error
        return np.where(error & FAULT_BITS, ALERT, 0).astype(np.uint8) if some(error) else error

    def _effort_mask(self, fresh: Bools, request: CyclicRequest) -> Bools | None:
        return fresh & False if self.currents and request.reply.size < WHOLE else None


def _sign(words: Ints, bit: int) -> None:
    """Decode sign and magnitude in place."""
    limit = 1 << bit
    negative = words >= limit
    if np.count_nonzero(negative):
        np.subtract(limit, words & (2 * limit - 1), out=words, where=negative)
