"""Reader of a Dynamixel bus: cyclic reading, slow registers, identification.

Runs in the loop's one thread. Accepts only queries: a mirror has no object that can write.
"""

from collections.abc import Mapping, Sequence
from math import inf

from twind_drivers.bus import (
    BusSample,
    DeviceRefused,
    IdentifiedDevice,
    NoReply,
    PingRequest,
    Query,
    ReadRequest,
    RebootRequest,
    RegisterAddress,
    Request,
    RequestReply,
    Script,
    SlowRegisterValues,
    WriteRequest,
)
from twind_drivers.byte_transport import ByteTransport
from twind_drivers.dynamixel import packet
from twind_drivers.dynamixel.control_tables import ControlTable, table
from twind_drivers.dynamixel.device_layout import DeviceLayout, layout_of
from twind_drivers.dynamixel.dynamixel_cyclic_read import DynamixelCyclicRead
from twind_drivers.dynamixel.dynamixel_identification import identify
from twind_drivers.dynamixel.dynamixel_slow_registers import DynamixelSlowRegisters
from twind_drivers.dynamixel.half_duplex_transactor import HalfDuplexTransactor, SerialTransaction
from twind_drivers.dynamixel.replies import FastSyncReadReply, PendingReply, StatusReply
from twind_drivers.dynamixel.serial_cycle_budget import (
    CYCLIC,
    budget,
    plain_reply,
    slice_bytes,
    sync_request,
    upkeep,
    wire,
)
from twind_drivers.slow_read_rate import upkeep_stride

LONGEST = 0.000508  # s, return delay: 254 steps of 2 us (e-manual, "Return Delay Time (9)"; factory: 250)
# s that a reply may take beyond its wire time: an adapter's timer adds up to 1 ms, so with less than that
# every reply would be late. At most half a period of the loop, else the next tick would start late.
SLACK = 0.002
SPARE = (
    0.25  # share of a cycle that the slow reads leave free: the loop needs it to start the next one in time
)
ADAPTER = 0.001  # s that a USB adapter may add to the cyclic reading (latency timer of 1 ms)
SLICE = 0.002  # s of bus time per transaction of a script, at most half a period; more would delay the tick


class DynamixelReader:
    """Reader of the devices `ids` of one bus. Arrays are (m,), in the order of `ids`, in raw units.

    `layouts`: register layout of each id; models of several layouts may share a bus. `slice` (s): bus time
    that one transaction of a script may take.
    """

    def __init__(
        self,
        name: str,
        transport: ByteTransport,
        ids: Sequence[int],
        models: Sequence[int],
        *,
        baud: int,
        return_delay_us: float,
        fast: bool | None = None,
        rate_hz: float = 100.0,
        slack: float | None = None,
        one_write: bool = True,
        sensors: Mapping[int, float] | None = None,
    ) -> None:
        """Make the reader; `models`: model number of each id.

        `fast`: use the fast reads; None: if `identify` finds that all devices support them.
        `return_delay_us`: the longest of the devices. `rate_hz`: rate of the loop. `slack` (s): time that a
        reply may take beyond its wire time; None: 2 ms, or half a period where that is less. `one_write`:
        goals and request leave in one system call. `sensors`: return delay (s) by id of the bus's sensors.

        Raises ValueError for no ids or ids given twice, and for a model that cannot be driven, with the
        reason; KeyError for an unknown model.
        """
        if not ids or len(ids) != len(models) or len(set(ids)) != len(ids):
            raise ValueError(
                f"{name}: {len(ids)} distinct ids need as many models, got {list(ids)}, {len(models)}"
            )
        self.name = name
        self.ids = tuple(ids)
        self.transport = transport
        tables = [table(number) for number in models]
        self.tables: dict[int, ControlTable] = dict(zip(self.ids, tables, strict=True))
        self.layouts: dict[int, DeviceLayout] = {id: layout_of(each) for id, each in self.tables.items()}
        self.line = HalfDuplexTransactor(
            name,
            transport,
            baud=baud,
            return_delay_s=return_delay_us * 1e-6,
            slack=min(SLACK, 0.5 / rate_hz) if slack is None else slack,
            one_write=one_write,
            sensors=tuple(sensors or ()),
        )
        self._sensors = dict(sensors or {})
        self._singles = dict[Query, SerialTransaction]()  # of sensors, read in each cycle
        layouts = tuple(self.layouts.values())
        self._described = self.line.return_delay_s
        self._period = 1.0 / rate_hz
        self._choose_fast = fast is None
        # query whose transaction was looked up last, whether as a fast read, and the transaction
        self._last: tuple[Query | None, bool, SerialTransaction | None] = (None, False, None)
        self._upkeep_hz = rate_hz / upkeep_stride(rate_hz)
        self.slice = min(SLICE, 0.5 / rate_hz)
        self.cyclic = DynamixelCyclicRead(self.ids, layouts, fast=bool(fast))
        self.slow = DynamixelSlowRegisters(self.ids, tables, layouts)
        self.registers: SlowRegisterValues = self.slow.registers
        self._schedule()
        self._query: Query | None = None  # the query of the rare transaction under way

    @property
    def deadline(self) -> float:
        """Latest end of the outstanding transaction, s."""
        return self.line.deadline

    @property
    def earliest(self) -> float:
        """Return -inf (unknown): an adapter delivers a whole reply at once, so an estimate saves nothing."""
        return -inf

    @property
    def fast(self) -> bool:
        """Return True if fast reads are used; every device supports them then."""
        return self.cyclic.fast

    @property
    def lags(self) -> bool:
        """Return True if the cyclic reading takes longer than a cycle with the settings of the devices."""
        return not self.fast and self._too_long

    @property
    def late_replies(self) -> Sequence[float]:
        """Delays (s) of the replies that came too late since identification began, newest last."""
        return self.line.late_replies.delays

    @property
    def _too_long(self) -> bool:
        """Return True if a plain reading of all devices, each with its return delay, exceeds a cycle."""
        delays = len(self.ids) * self.line.return_delay_s
        size = sync_request(len(self.ids)) + plain_reply(len(self.ids), CYCLIC)
        return wire(size, self.line.baud) + delays > self._period

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
        if self._requested is not self.cyclic.attendance.asked:
            self._schedule()
        return sample

    def _schedule(self) -> None:
        """Make the slices of slow registers of the devices that are not parked."""
        self._requested = requested = self.cyclic.attendance.asked
        ids = [id for id, there in zip(self.ids, requested.tolist(), strict=True) if there]
        layouts = [self.layouts[id] for id in ids]
        groups = [layouts.count(each) for each in dict.fromkeys(layouts)]
        wide = upkeep(groups, self._upkeep_hz, fast=self.fast, fits=self._has_room)
        # While replies are missing, slices are read plainly, which takes longer.
        narrow = upkeep(groups, self._upkeep_hz, fast=self.fast)
        self._last = (None, False, None)
        queries = self.slow.schedule(ids, wide, narrow)
        self._plain: dict[Query, SerialTransaction] = {query: self._exchange(query) for query in queries}
        self._fast: dict[Query, SerialTransaction] = {
            query: _fast(query) for query in queries if len(query.ids) > 1
        }

    def _has_room(self, count: int, size: int) -> bool:
        """Check that a read of `size` bytes of `count` devices takes at most half of a cycle's free time."""
        delay = self.line.return_delay_s
        free = (1.0 - SPARE) * self._period - self._cyclic_seconds(ADAPTER)
        delays = 1 if self.fast else count
        slow = wire(slice_bytes(count, size, fast=self.fast), self.line.baud) + delays * delay
        return slow <= min(self.slice, 0.5 * free)

    def _cyclic_seconds(self, adapter: float) -> float:
        """Return the bus time of goals and cyclic reading, s; `adapter` (s): what the adapter adds."""
        delay_us = self.line.return_delay_s * 1e6
        return budget(
            len(self.ids), self.line.baud, fast=self.fast, return_delay_us=delay_us, usb_s=adapter
        ).seconds

    # --------------------------------------------------------------------------- the rare path

    def begin(self, query: Query, now: float) -> None:
        """Begin one query. Raises PortError; TypeError for anything that writes."""
        if not isinstance(query, PingRequest | ReadRequest):
            raise TypeError(f"{self.name}: a reader does not write: {query}")
        self.line.send(self._transaction(query), now)
        self._query = query
        if isinstance(query, ReadRequest) and self._is_probe(query):
            self.cyclic.attendance.probed(self.ids.index(query.ids[0]), now)

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
        return (
            self.slow.next(narrow=self.cyclic.trouble)
            if place is None
            else ReadRequest((self.ids[place],), *self.cyclic.block(place))
        )

    def span(self, query: Request) -> float:
        """Return the upper bound of a transaction's bus time (s), its timeout excluded."""
        if isinstance(query, PingRequest | ReadRequest):
            return self.line.span(self._transaction(query))
        writes = (
            ()
            if isinstance(query, RebootRequest)
            else (query,)
            if isinstance(query, WriteRequest)
            else query.writes
        )
        size = sum(14 + sum(1 + len(data) for data in each.data.values()) for each in writes)
        return wire(size + 21, self.line.baud) + self.line.return_delay_s

    def _transaction(self, query: Query) -> SerialTransaction:
        """Return the transaction of a query: fast unless a reply is missing, and made only once."""
        fast = self.fast and not self.cyclic.trouble
        last, was_fast, transaction = self._last
        if query is last and fast is was_fast and transaction is not None:
            return transaction  # asked for its span, then for itself; a hash of its ids costs more
        made = self._look_up(query, fast=fast)
        self._last = (query, fast, made)
        return made

    def _look_up(self, query: Query, *, fast: bool) -> SerialTransaction:
        found = self._fast.get(query) if fast else None
        return found or self._plain.get(query) or self._singles.get(query) or self._exchange(query)

    def _exchange(self, query: Query) -> SerialTransaction:
        if isinstance(query, PingRequest):
            return SerialTransaction(packet.ping(query.id), StatusReply((query.id,), 3), 1)
        reply = StatusReply(query.ids, query.size)
        if len(query.ids) == 1:
            id = query.ids[0]
            longer = max(0.0, self._sensors.get(id, 0.0) - self.line.return_delay_s)
            made = SerialTransaction(packet.read(id, query.address, query.size), reply, 1, longer)
            if id in self._sensors:  # read in each cycle: the same object saves time
                self._singles[query] = made
            return made
        request = packet.sync_read(query.ids, query.address, query.size)
        return SerialTransaction(request, reply, len(query.ids))

    def _is_probe(self, query: ReadRequest) -> bool:
        [id, *others] = query.ids or (-1,)
        return not others and id in self.tables and not self._requested[self.ids.index(id)]

    def _welcome(self, answered: Mapping[int, int], now: float) -> None:
        """Take back each parked device that replies; its slow registers are read next."""
        for id in answered:
            if id in self.tables and not self.cyclic.attendance.asked[place := self.ids.index(id)]:
                self.cyclic.back(place, now)
                self._schedule()
                self.slow.ask_first(id)

    # --------------------------------------------------------------------------- scripts

    def identify(self, *, patient: bool = False) -> Script[tuple[IdentifiedDevice, ...]]:
        """Ping every id and read its settings; return the devices that reply, in order of `ids`.

        From then on register names refer to the models found. The fast read is used if the firmware of every
        device supports it. The deadline of replies follows from the return delays read. `patient`: as in
        `BusReader.identify`; afterwards the cyclic reading starts anew.
        """
        before = self.line.return_delay_s
        self.line.late_replies.delays.clear()
        self.line.return_delay_s = LONGEST if patient else before
        try:
            devices, tables, fast = yield from identify(self)
        finally:
            self.line.return_delay_s = before
        self.tables.update(tables)
        found = [
            each.settings["return_delay_time"] for each in devices if "return_delay_time" in each.settings
        ]
        if found:
            self.line.return_delay_s = max(self._described, 2e-6 * max(found))
        if self._choose_fast:
            self.cyclic.fast = fast and len(devices) == len(self.ids)
        self.cyclic.hasten(self.fast and self._too_long)
        if patient:
            self.cyclic.begin_anew()
        self._schedule()
        return devices

    def collect(self, ids: Sequence[int], address: int, size: int) -> Script[Mapping[int, bytes]]:
        """Read the same block of several devices, in slices that fit beside a cycle.

        Silent devices get a second request: one lost packet is no missing device. Raises NoReply naming the
        silent ones, DeviceRefused for the first that reports an error.
        """
        found: dict[int, bytes] = {}
        waited = 0.0
        each = wire(11 + size, self.line.baud) + self.line.return_delay_s
        count = max(1, int(self.slice / each))
        for _ in range(2):
            missing = [id for id in ids if id not in found]
            for first in range(0, len(missing), count):
                reply = yield ReadRequest(tuple(missing[first : first + count]), address, size)
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

    def read(self, id: int, name: str) -> Script[RegisterAddress]:
        """Read one register by its name. Raises NoReply, DeviceRefused, KeyError (lists similar names)."""
        field = self.table(id)[name]
        data = yield from self.collect((id,), field.address, field.size)
        return RegisterAddress(field.name, field.address, field.size, field.decode(data[id]), field.eeprom)

    def keeps(self, id: int, name: str) -> bool:
        """Return True for EEPROM registers: addresses below 64 in the X series. Raises KeyError."""
        return self.table(id)[name].eeprom

    def table(self, id: int) -> ControlTable:
        """Return the control table of a device. Raises KeyError that lists the ids of this bus."""
        if id not in self.tables:
            raise KeyError(f"{self.name} has no id {id}; its ids are {list(self.ids)}")
        return self.tables[id]


def _fast(query: ReadRequest) -> SerialTransaction:
    reply = FastSyncReadReply(query.ids, query.size)
    return SerialTransaction(packet.fast_sync_read(query.ids, query.address, query.size), reply, 1)
