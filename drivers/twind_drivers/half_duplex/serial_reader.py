"""Reader of a serial bus, the part that all families of serial servos share.

Cyclic reading, rare path, upkeep and presence. A family adds its requests, tables and identification.
"""

from collections.abc import Mapping, Sequence
from math import inf
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from twind_drivers.bus import (
    Bools,
    BusSample,
    DeviceRefused,
    NoReply,
    PingRequest,
    Query,
    ReadRequest,
    RequestReply,
    Script,
    SlowRegisterValues,
)
from twind_drivers.byte_transport import ByteTransport
from twind_drivers.half_duplex.cyclic_read import CyclicRead
from twind_drivers.half_duplex.half_duplex_transactor import HalfDuplexTransactor, SerialTransaction
from twind_drivers.half_duplex.host_watchdog import HostWatchdog
from twind_drivers.half_duplex.pending_reply import PendingReply, wire


class SlowRegisterSchedule(Protocol):
    """Slow registers of a bus: whose turn it is, and the values from the replies."""

    def next(self, *, narrow: bool = False) -> ReadRequest | None:
        """Return the next slice; None: nothing is due in this turn."""

    def ask_first(self, id: int) -> None:
        """Schedule all slow registers of a returned device first."""

    def forget(self, id: int) -> None:
        """Reset the values of a restarted device to unknown."""

    def update_from_replies(
        self, query: ReadRequest, ids: Sequence[int], data: NDArray[np.uint8], time: float
    ) -> None:
        """Store the registers from the replies of `ids` (k) to `query`, `data` (k, size) bytes."""


class SerialReader:
    """Reader of the devices `ids` of one serial bus. Arrays are (m,), in the order of `ids`."""

    name: str
    ids: tuple[int, ...]
    transport: ByteTransport
    line: HalfDuplexTransactor
    cyclic: CyclicRead
    slow: SlowRegisterSchedule
    registers: SlowRegisterValues
    slice: float  # s, bus time that one transaction of a script may take
    overhead: int  # bytes of a status without data
    watchdog: HostWatchdog | None = None  # of devices without one of their own
    _requested: Bools  # (m,) devices that the slices of slow registers are made for
    _query: Query | None  # the query of the rare transaction under way
    _slice: Query | None = None  # the slice of slow registers, or the probe, that is due

    @property
    def deadline(self) -> float:
        """Latest end of the outstanding transaction, s."""
        return self.line.deadline

    @property
    def earliest(self) -> float:
        """Return -inf (unknown): an adapter delivers a whole reply at once, so an estimate saves nothing."""
        return -inf

    @property
    def late_replies(self) -> Sequence[float]:
        """Delays (s) of the replies that came too late since identification began, newest last."""
        return self.line.late_replies.delays

    # --------------------------------------------------------------------------- the cyclic reading

    def request(self, now: float, latest: float = -inf) -> None:
        """Begin the cyclic reading: pending goals and the request leave together. Raises PortError."""
        self.line.send(self.cyclic.next(), now, goals=True, latest=latest)

    def feed(self, now: float) -> bool:
        """Process received bytes; return True when the transaction is complete. Raises PortError."""
        return self.line.feed(now)

    def finish(self, now: float) -> BusSample:
        """End the cyclic reading with the received replies; zeros for silent devices."""
        if self.line.end() is None:
            raise RuntimeError(f"{self.name}: finish without request")
        sample = self.cyclic.sample(self.line, now)
        if self.watchdog is not None:
            self.watchdog.record(sample.heard, now)
        if self._requested is not self.cyclic.attendance.asked:
            self._schedule()
        return sample

    # --------------------------------------------------------------------------- the rare path

    def begin(self, query: Query, now: float, latest: float = -inf) -> None:
        """Begin one query. Raises PortError; TypeError for anything that writes."""
        if not isinstance(query, PingRequest | ReadRequest):
            raise TypeError(f"{self.name}: a reader does not write: {query}")
        if query is not self._slice:  # values of slow registers are dropped in doubt instead (`_fold`)
            self.line.settle(query.ids if isinstance(query, ReadRequest) else (query.id,))
        probed = query.ids[0] if isinstance(query, ReadRequest) and self._is_probe(query) else None
        self.line.send(self._transaction(query), now, latest=latest if probed is None else -inf)
        self._query = query
        if probed is not None:
            self.cyclic.attendance.probed(self.ids.index(probed), now)

    def answer(self, now: float) -> RequestReply:
        """End the transaction. Values of slow registers are kept in `registers`, with their time.

        Values of a device without proven reply in the cyclic reading are dropped: they may be the late reply
        to an earlier request.
        """
        exchange = self.line.end()
        query = self._query
        self._query = None
        reply: PendingReply | None = exchange.reply if exchange else None
        waited = now - self.line.sent
        if reply is None:
            return RequestReply({}, {}, waited, self.line.strays)
        fresh = reply.heard.tolist()
        answered = reply.answered.tolist()
        errors = reply.error.tolist()
        data = {id: reply.data[i].tobytes() for i, id in enumerate(reply.ids) if fresh[i]}
        error = {id: errors[i] for i, id in enumerate(reply.ids) if answered[i]}
        if isinstance(query, ReadRequest):
            self._fold(query, reply)
        if self.cyclic.attendance.parked:
            self._welcome(error, now)
        return RequestReply(data, error, waited, self.line.strays)

    def _fold(self, query: ReadRequest, reply: PendingReply) -> None:
        if reply.whole and not self.cyclic.trouble:
            self.slow.update_from_replies(query, reply.ids, reply.data, self.line.received)
            return
        sound = reply.heard.copy()
        if self.cyclic.trouble:
            late = {id for id, ok in zip(self.ids, self.cyclic.proven.tolist(), strict=True) if not ok}
            sound &= [id not in late for id in reply.ids]
        ids = tuple(id for id, ok in zip(reply.ids, sound.tolist(), strict=True) if ok)
        self.slow.update_from_replies(query, ids, reply.data[sound], self.line.received)

    def upkeep(self, now: float) -> Query | None:
        """Return the next slice of the slow registers, round robin (arithmetic: `SlowReadSchedule`), or None.

        Or the probe of a parked device, in the end once a second: a read of its cyclic block.
        """
        place = self.cyclic.attendance.due(now)
        self._slice = (
            self.slow.next(narrow=self.cyclic.trouble)
            if place is None
            else ReadRequest((self.ids[place],), *self.block(place))
        )
        return self._slice

    def _is_probe(self, query: ReadRequest) -> bool:
        [id, *others] = query.ids or (-1,)
        return not others and id in self.ids and not self._requested[self.ids.index(id)]

    def _welcome(self, answered: Mapping[int, int], now: float) -> None:
        """Take back each parked device that replies; its slow registers are read next."""
        for id in answered:
            if id in self.ids and not self.cyclic.attendance.asked[place := self.ids.index(id)]:
                self.cyclic.back(place, now)
                self._schedule()
                self.slow.ask_first(id)

    def collect(self, ids: Sequence[int], address: int, size: int) -> Script[Mapping[int, bytes]]:
        """Read the same block of several devices, in slices that fit beside a cycle.

        Silent devices get a second request: one lost packet is no missing device. All are asked before it
        raises DeviceRefused for the first that reports an error, else NoReply naming the silent ones.
        """
        found: dict[int, bytes] = {}
        errors: dict[int, int] = {}
        waited = 0.0
        each = wire(self.overhead + size, self.line.baud) + self.line.return_delay_s
        count = max(1, int(self.slice / each))
        for _ in range(2):
            missing = [id for id in ids if id not in found and id not in errors]
            for first in range(0, len(missing), count):
                reply = yield ReadRequest(tuple(missing[first : first + count]), address, size)
                found.update(reply.data)
                waited += reply.waited
                errors.update({id: error for id, error in reply.error.items() if id not in reply.data})
        for id, error in errors.items():
            raise DeviceRefused(self.name, id, f"read of {address}, {size}", self.explain(error))
        silent = [id for id in ids if id not in found]
        if silent:
            raise NoReply(self.name, silent, waited, f"read of {address}, {size} bytes")
        return found

    # ------------------------------------------------------------------------- what a family answers

    def block(self, place: int) -> tuple[int, int]:
        """Return address and size of the cyclic block of one device."""
        raise NotImplementedError

    def explain(self, error: int) -> str:
        """Return the meaning of the error byte of a status."""
        raise NotImplementedError

    def _schedule(self) -> None:
        """Make the slices of slow registers of the devices that are not parked; set `_requested`."""
        raise NotImplementedError

    def _transaction(self, query: Query) -> SerialTransaction:
        """Return the transaction of a query."""
        raise NotImplementedError
