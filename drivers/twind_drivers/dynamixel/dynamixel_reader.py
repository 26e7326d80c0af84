"""Reader of a Dynamixel bus: cyclic reading, slow registers, identification.

Runs in the loop's one thread. Accepts only queries: a mirror has no object that can write.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from twind_drivers.bus import (
    IdentifiedDevice,
    PingRequest,
    Query,
    ReadRequest,
    RebootRequest,
    Request,
    Script,
    SlowRegisterValues,
    WriteRequest,
)
from twind_drivers.byte_transport import ByteTransport
from twind_drivers.device_registers import RegisterAddress
from twind_drivers.dynamixel import packet
from twind_drivers.dynamixel.control_tables import ControlTable, table
from twind_drivers.dynamixel.device_layout import DeviceLayout, layout_of
from twind_drivers.dynamixel.dynamixel_cyclic_read import CodedAlertRead, DynamixelCyclicRead
from twind_drivers.dynamixel.dynamixel_identification import identify
from twind_drivers.dynamixel.dynamixel_slow_registers import DynamixelSlowRegisters
from twind_drivers.dynamixel.replies import FastSyncReadReply, StatusReply
from twind_drivers.dynamixel.serial_cycle_budget import (
    CYCLIC,
    budget,
    plain_reply,
    slice_bytes,
    sync_request,
    upkeep,
)
from twind_drivers.half_duplex.half_duplex_transactor import HalfDuplexTransactor, SerialTransaction
from twind_drivers.half_duplex.pending_reply import wire
from twind_drivers.half_duplex.serial_reader import SerialReader
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


class DynamixelReader(SerialReader):
    """Reader of the devices `ids` of one bus. Arrays are (m,), in the order of `ids`, in raw units.

    `layouts`: register layout of each id; models of several layouts may share a bus. `slice` (s): bus time
    that one transaction of a script may take.
    """

    overhead = packet.STATUS_OVERHEAD

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
            find_packets=packet.find_packets,
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
        self.slow: DynamixelSlowRegisters = DynamixelSlowRegisters(self.ids, tables, layouts)
        self.cyclic: DynamixelCyclicRead = self._cyclic_read(layouts, fast=bool(fast))
        self.registers: SlowRegisterValues = self.slow.registers
        self._schedule()
        self._query = None

    def _cyclic_read(self, layouts: Sequence[DeviceLayout], *, fast: bool) -> DynamixelCyclicRead:
        """Make the reading of each cycle. Devices that code their errors have no fast reads."""
        coded = np.array([self.tables[id].codes_errors for id in self.ids])
        if coded.any():
            return CodedAlertRead(self.ids, tuple(layouts), coded, self.slow.registers)
        return DynamixelCyclicRead(self.ids, tuple(layouts), fast=fast)

    @property
    def fast(self) -> bool:
        """Return True if fast reads are used; every device supports them then."""
        return self.cyclic.fast

    @property
    def lags(self) -> bool:
        """Return True if the cyclic reading takes longer than a cycle with the settings of the devices."""
        return not self.fast and self._too_long

    @property
    def _too_long(self) -> bool:
        """Return True if a plain reading of all devices, each with its return delay, exceeds a cycle."""
        delays = len(self.ids) * self.line.return_delay_s
        size = sync_request(len(self.ids)) + plain_reply(len(self.ids), CYCLIC)
        return wire(size, self.line.baud) + delays > self._period

    def _schedule(self) -> None:
        """Make the slices of slow registers of the devices that are not parked."""
        self._requested = requested = self.cyclic.attendance.asked
        ids = [id for id, there in zip(self.ids, requested.tolist(), strict=True) if there]
        layouts = [self.layouts[id] for id in ids]
        # The status of a Y takes a slice for each of its blocks.
        groups = [layouts.count(each) for each in dict.fromkeys(layouts) for _ in each.status]
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

    def read(self, id: int, name: str) -> Script[RegisterAddress]:
        """Read one register by its name. Raises NoReply, DeviceRefused, KeyError (lists similar names)."""
        field = self.table(id)[name]
        data = yield from self.collect((id,), field.address, field.size)
        return RegisterAddress(field.name, field.address, field.size, field.decode(data[id]), field.eeprom)

    def keeps(self, id: int, name: str) -> bool:
        """Return True for EEPROM registers: addresses below 64 in the X series. Raises KeyError."""
        return self.table(id)[name].eeprom

    def block(self, place: int) -> tuple[int, int]:
        """Return address and size of the cyclic block of one device."""
        return self.cyclic.block(place)

    def explain(self, error: int) -> str:
        """Return the meaning of the error byte of a status."""
        return packet.explain(error)

    def table(self, id: int) -> ControlTable:
        """Return the control table of a device. Raises KeyError that lists the ids of this bus."""
        if id not in self.tables:
            raise KeyError(f"{self.name} has no id {id}; its ids are {list(self.ids)}")
        return self.tables[id]


def _fast(query: ReadRequest) -> SerialTransaction:
    reply = FastSyncReadReply(query.ids, query.size)
    return SerialTransaction(packet.fast_sync_read(query.ids, query.address, query.size), reply, 1)
