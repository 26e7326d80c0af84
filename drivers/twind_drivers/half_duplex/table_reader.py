"""Reader of a bus of serial servos with register tables, the part that the families share."""

from collections.abc import Mapping, Sequence

from twind_drivers.bus import (
    GroupWriteBatch,
    IdentifiedDevice,
    PingRequest,
    Query,
    ReadRequest,
    Request,
    Script,
    SlowRegisterValues,
    WriteRequest,
)
from twind_drivers.byte_transport import ByteTransport
from twind_drivers.device_registers import RegisterAddress
from twind_drivers.half_duplex.half_duplex_transactor import HalfDuplexTransactor, SerialTransaction
from twind_drivers.half_duplex.host_watchdog import HostWatchdog
from twind_drivers.half_duplex.line_codec import CHECKSUM, LineCodec
from twind_drivers.half_duplex.pending_reply import wire
from twind_drivers.half_duplex.register_table import RegisterTable
from twind_drivers.half_duplex.serial_reader import SerialReader
from twind_drivers.half_duplex.slow_register_slices import ROUNDS_HZ, SlowRegisterSlices
from twind_drivers.slow_read_rate import upkeep_stride

SLACK = 0.002  # s that a reply may take beyond its wire time; at most half a period of the loop
SLICE = 0.002  # s of bus time per transaction of a script, at most half a period


class TableReader(SerialReader):
    """Reader of devices with a register table each. Arrays are (m,), in the order of `ids`."""

    codec: LineCodec = CHECKSUM
    slow: SlowRegisterSlices

    def __init__(
        self,
        name: str,
        transport: ByteTransport,
        ids: Sequence[int],
        models: Sequence[str],
        *,
        baud: int,
        return_delay_s: float,
        rate_hz: float,
        one_write: bool,
        slack: float | None = None,
    ) -> None:
        """Open the line; a family then makes `cyclic` and calls `_begin`.

        `models`: name of each id. `rate_hz`: rate of the loop. `slack` (s): time that a reply may take beyond
        its wire time; None: 2 ms, or half a period where that is less. Raises ValueError for no ids, ids
        given twice, or another number of models.
        """
        if not ids or len(ids) != len(models) or len(set(ids)) != len(ids):
            raise ValueError(
                f"{name}: {len(ids)} distinct ids need as many models, got {list(ids)}, {len(models)}"
            )
        self.name = name
        self.overhead = self.codec.overhead
        self.ids = tuple(ids)
        self.transport = transport
        self.devices: dict[int, IdentifiedDevice] = {}
        self.line = HalfDuplexTransactor(
            name,
            transport,
            baud=baud,
            return_delay_s=return_delay_s,
            slack=min(SLACK, 0.5 / rate_hz) if slack is None else slack,
            find_packets=self.codec.find_packets,
            one_write=one_write,
        )
        self.slice = min(SLICE, 0.5 / rate_hz)
        self._period = 1.0 / rate_hz
        self._upkeep_hz = rate_hz / upkeep_stride(rate_hz)
        self._query = None
        self._known: dict[Query, SerialTransaction] = {}  # of the slices of slow registers

    def _begin(self, slow: SlowRegisterSlices) -> None:
        """Take the slow registers, and schedule their reading."""
        self.slow = slow
        self.registers: SlowRegisterValues = slow.registers
        self.watchdog: HostWatchdog = HostWatchdog(self.registers, self._period)
        self._schedule()

    @property
    def tables(self) -> Mapping[int, RegisterTable]:
        """Register table by id; the expected one until `identify`."""
        raise NotImplementedError

    def slice_count(self, size: int) -> int:
        """Return the devices whose read of `size` bytes fits one transaction of a script."""
        each = wire(self.overhead + size + 1, self.line.baud) + self.line.return_delay_s
        return max(1, int(self.slice / each))

    def _schedule(self) -> None:
        """Make the slices of slow registers of the devices that are not parked."""
        self._requested = requested = self.cyclic.attendance.asked
        self.registers.expire_torque(~requested)  # who was silent so long may have lost its supply
        ids = [id for id, there in zip(self.ids, requested.tolist(), strict=True) if there]
        slots = max(1, int(self._upkeep_hz / ROUNDS_HZ + 1e-9))
        slices = self.slow.schedule(ids, slots, self.slice_count(self.slow.block[1]))
        self._known = {query: self._exchange(query) for query in slices}

    def span(self, query: Request) -> float:
        """Return the upper bound of a transaction's bus time (s), its timeout excluded."""
        if isinstance(query, PingRequest | ReadRequest):
            return self.line.span(self._transaction(query))
        writes = query.writes if isinstance(query, GroupWriteBatch) else (query,)
        size = sum(
            self.codec.request + sum(1 + len(data) for data in each.data.values())
            for each in writes
            if isinstance(each, WriteRequest)
        )
        return wire(size + self.overhead + self.codec.request, self.line.baud) + self.line.return_delay_s

    def _transaction(self, query: Query) -> SerialTransaction:
        return self._known.get(query) or self._exchange(query)

    def _exchange(self, query: Query) -> SerialTransaction:
        """Return a new transaction of a query."""
        raise NotImplementedError

    def values(self, ids: Sequence[int], address: int, size: int) -> Script[dict[int, Mapping[str, int]]]:
        """Read one block of several devices; return its registers by id. Raises NoReply."""
        raw = yield from self.collect(ids, address, size)
        return {id: self.tables[id].values(address, data) for id, data in raw.items()}

    def read(self, id: int, name: str) -> Script[RegisterAddress]:
        """Read one register by its name. Raises NoReply, KeyError, InvalidInput (lists similar names)."""
        field = self.table(id)[name]
        data = yield from self.collect((id,), field.address, field.size)
        return RegisterAddress(field.name, field.address, field.size, field.decode(data[id]), field.kept)

    def keeps(self, id: int, name: str) -> bool:
        """Return True for registers that survive power-off. Raises KeyError."""
        return self.table(id)[name].kept

    def table(self, id: int) -> RegisterTable:
        """Return the register table of a device. Raises KeyError that lists the ids of this bus."""
        if id not in self.tables:
            raise KeyError(f"{self.name} has no id {id}; its ids are {list(self.ids)}")
        return self.tables[id]
