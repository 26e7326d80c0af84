"""The reading half of a Dynamixel bus: cyclic reading, upkeep of the slow registers, identification.

Runs in the loop's one thread. Accepts only queries: a mirror has no object that can write.
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from twind_drivers.bus import (
    Device,
    DeviceRefused,
    NoReply,
    Ping,
    Query,
    Read,
    Reboot,
    Register,
    Registers,
    Reply,
    Request,
    Sample,
    Script,
    Transport,
    Write,
)
from twind_drivers.dynamixel import packet
from twind_drivers.dynamixel.budget import upkeep, wire
from twind_drivers.dynamixel.identity import identify
from twind_drivers.dynamixel.layout import layout_of
from twind_drivers.dynamixel.line import Exchange, Line
from twind_drivers.dynamixel.replies import Expected, FastReply, PlainReply
from twind_drivers.dynamixel.slow import SlowRegisters
from twind_drivers.dynamixel.tables import Table, table

CYCLIC = np.dtype([("effort", "<i2"), ("velocity", "<i4"), ("position", "<i4")])
CALM = 10  # whole plain cycles in a row before the fast read is tried again
SLICE = 0.002  # s of bus time that one transaction of a script may take


class DynamixelReader:
    """A bus by its ids. Arrays are in the order of `ids`; raw ticks and register units."""

    def __init__(
        self,
        name: str,
        transport: Transport,
        ids: Sequence[int],
        models: Sequence[int],
        *,
        baud: int,
        return_delay_us: float,
        fast: bool | None = None,
        rate_hz: float = 100.0,
        slack: float = 0.002,
    ) -> None:
        """`models`: model number of each id. `fast`: use the fast sync read; None: what `identify` finds.

        `return_delay_us`: the longest of the devices. `rate_hz`: how often the loop calls. `slack` (s):
        what a reply may take beyond its wire time. Raises ValueError for mixed layouts or ids
        given twice, KeyError for an unknown model.
        """
        if len(ids) != len(models) or len(set(ids)) != len(ids):
            raise ValueError(
                f"{name}: {len(ids)} distinct ids need as many models, got {list(ids)}, {len(models)}"
            )
        self.name, self.ids, self.transport = name, tuple(ids), transport
        tables = [table(number) for number in models]
        self.tables: dict[int, Table] = dict(zip(self.ids, tables, strict=True))
        self.layout = layout_of(tables)
        self.line = Line(name, transport, baud=baud, return_delay_s=return_delay_us * 1e-6, slack=slack)
        self.fast = bool(fast)
        self._choose_fast = fast is None
        block = self.layout.cyclic
        self._plain = _group(packet.sync_read, PlainReply(self.ids, block.size), block.address, len(ids))
        self._fast = _group(packet.fast_sync_read, FastReply(self.ids, block.size), block.address, 1)
        self._calm = 0  # plain cycles still to come before the fast read is trusted again
        self.slow = SlowRegisters(self.ids, tables, self.layout, upkeep(len(ids), rate_hz))
        self.registers: Registers = self.slow.registers
        self._slices: dict[Query, Exchange] = {query: self._exchange(query) for query in self.slow.queries}
        self._query: Request | None = None

    @property
    def deadline(self) -> float:
        """When the outstanding transaction ends at the latest, s."""
        return self.line.deadline

    # --------------------------------------------------------------------------- the cyclic reading

    def request(self, now: float) -> None:
        """Begin the cyclic reading: pending goals and the request leave in one write. Raises PortError."""
        self.line.send(self._fast if self.fast and not self._calm else self._plain, now, goals=True)

    def feed(self, now: float) -> bool:
        """Take what has arrived; True when the transaction is complete. Raises PortError."""
        return self.line.feed(now)

    def finish(self, now: float) -> Sample:
        """End the cyclic reading with what was heard; zeros where a device stayed silent."""
        exchange = self.line.end()
        reply: Expected | None = exchange.reply if exchange else None
        if reply is None:
            raise RuntimeError(f"{self.name}: finish without request")
        rows = reply.data.view(CYCLIC)[:, 0]
        heard = reply.heard.copy()
        self._trust(exchange is self._fast, np.count_nonzero(heard) == len(heard))
        return Sample(
            sent=self.line.sent,
            received=self.line.received,
            position=rows["position"].astype(np.int64),
            velocity=rows["velocity"].astype(np.int64),
            effort=rows["effort"].astype(np.int64),
            error=reply.error,
            heard=heard,
            asked=np.ones(len(heard), np.bool_),
            foreign=0,
            discarded=self.line.strays,
        )

    def _trust(self, fast: bool, whole: bool) -> None:
        """A hole hides all devices behind it in a fast reply: read plainly until ten cycles were whole."""
        if not whole:
            self._calm = CALM
        elif not fast and self._calm:
            self._calm -= 1

    # --------------------------------------------------------------------------- the rare path

    def begin(self, query: Query, now: float) -> None:
        """Begin one query. Raises PortError; TypeError for anything that writes."""
        if not isinstance(query, Ping | Read):
            raise TypeError(f"{self.name}: a reader does not write: {query}")
        self._query = query
        self.line.send(self._slices.get(query) or self._exchange(query), now)

    def answer(self, now: float) -> Reply:
        """End it. What was read of the slow registers is kept in `registers`, with its time."""
        exchange = self.line.end()
        reply: Expected | None = exchange.reply if exchange else None
        waited = now - self.line.sent
        if reply is None:
            return Reply({}, {}, waited, self.line.strays)
        heard, answered, errors = reply.heard.tolist(), reply.answered.tolist(), reply.error.tolist()
        data = {id: reply.data[i].tobytes() for i, id in enumerate(reply.ids) if heard[i]}
        error = {id: errors[i] for i, id in enumerate(reply.ids) if answered[i]}
        if isinstance(self._query, Read):
            self.slow.fold(self._query, data, self.line.received)
        self._query = None
        return Reply(data, error, waited, self.line.strays)

    def upkeep(self, now: float) -> Query:
        """The next slice of the slow registers, round robin (the arithmetic: `budget.Upkeep`)."""
        return self.slow.next()

    def span(self, query: Request) -> float:
        """Bus time (s) that a transaction takes at most, its timeout excluded."""
        if isinstance(query, Ping | Read):
            return self.line.span(self._slices.get(query) or self._exchange(query))
        writes = () if isinstance(query, Reboot) else (query,) if isinstance(query, Write) else query.writes
        size = sum(14 + sum(1 + len(data) for data in each.data.values()) for each in writes)
        return wire(size + 21, self.line.baud) + self.line.return_delay_s

    def _exchange(self, query: Query) -> Exchange:
        if isinstance(query, Ping):
            return Exchange(packet.ping(query.id), PlainReply((query.id,), 3), 1)
        if len(query.ids) == 1:
            reply = PlainReply(query.ids, query.size)
            return Exchange(packet.read(query.ids[0], query.address, query.size), reply, 1)
        reply = PlainReply(query.ids, query.size)
        return _group(packet.sync_read, reply, query.address, len(query.ids))

    # --------------------------------------------------------------------------- scripts

    def identify(self) -> Script[tuple[Device, ...]]:
        """Ping every id and read its settings; devices that answer, in order of `ids`.

        From here on names mean the registers of the models that are really there, and the fast read is used
        if every device's firmware has it.
        """
        devices, tables, fast = yield from identify(self)
        self.tables.update(tables)
        if self._choose_fast:
            self.fast = fast and len(devices) == len(self.ids)
        return devices

    def collect(self, ids: Sequence[int], address: int, size: int) -> Script[Mapping[int, bytes]]:
        """The same block of several devices, in slices that fit beside a cycle; who is silent is asked twice.

        Raises NoReply naming the silent, DeviceRefused for the first that answers with an error.
        """
        found: dict[int, bytes] = {}
        waited = 0.0
        each = wire(11 + size, self.line.baud) + self.line.return_delay_s
        count = max(1, int(SLICE / each))
        for _ in range(2):
            missing = [id for id in ids if id not in found]
            for first in range(0, len(missing), count):
                reply = yield Read(tuple(missing[first : first + count]), address, size)
                found.update(reply.data)
                waited += reply.waited
                for id, error in reply.error.items():
                    if id not in reply.data:
                        raise DeviceRefused(
                            self.name, id, f"read of {address}, {size}", packet.explain(error)
                        )
        silent = [id for id in ids if id not in found]
        if silent:
            raise NoReply(self.name, silent, waited, f"read of {address}, {size} bytes")
        return found

    def read(self, id: int, name: str) -> Script[Register]:
        """One register by its name. Raises NoReply, DeviceRefused, KeyError (lists the near names)."""
        field = self.table(id)[name]
        data = yield from self.collect((id,), field.address, field.size)
        return Register(field.name, field.address, field.size, field.decode(data[id]))

    def table(self, id: int) -> Table:
        """Control table of a device. Raises KeyError that lists the ids of this bus."""
        if id not in self.tables:
            raise KeyError(f"{self.name} has no id {id}; its ids are {list(self.ids)}")
        return self.tables[id]


def _group(
    build: Callable[[Sequence[int], int, int], bytes],
    reply: PlainReply | FastReply,
    address: int,
    delays: int,
) -> Exchange:
    return Exchange(build(reply.ids, address, reply.size), reply, delays)
