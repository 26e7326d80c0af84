"""Reader of a bus of Protocol 1.0: cyclic reading, slow registers, identification.

Runs in the loop's one thread. Accepts only queries: a mirror has no object that can write.
"""

from collections.abc import Mapping, Sequence

from twind_drivers.bus import (
    IdentifiedDevice,
    NoReply,
    PingRequest,
    Query,
    ReadRequest,
    Script,
)
from twind_drivers.byte_transport import ByteTransport
from twind_drivers.device_registers import RegisterAddress
from twind_drivers.dynamixel1.dynamixel1_budget import SIZE, TURNAROUND, Dynamixel1Cycle
from twind_drivers.dynamixel1.dynamixel1_cyclic_read import Dynamixel1CyclicRead, group_transaction
from twind_drivers.dynamixel1.dynamixel1_identification import IDENTITY, identify, slices
from twind_drivers.dynamixel1.dynamixel1_models import model
from twind_drivers.dynamixel1.dynamixel1_packet import FAULT_BITS, explain
from twind_drivers.dynamixel1.dynamixel1_registers import START, table_of
from twind_drivers.dynamixel1.dynamixel1_slow_registers import Dynamixel1SlowRegisters
from twind_drivers.half_duplex.half_duplex_transactor import SerialTransaction
from twind_drivers.half_duplex.pending_reply import PendingReply
from twind_drivers.half_duplex.register_table import RegisterTable
from twind_drivers.half_duplex.table_reader import TableReader

LONGEST = 0.000508  # s of return delay, 254 steps of register 5
ERRORS = "hardware_error_status"  # no register: the error byte of a reply, by the name of other families


class Dynamixel1Reader(TableReader):
    """Reader of the devices `ids` of one bus. Arrays are (m,), in the order of `ids`, in raw units.

    Effort is the load (0.1 % of the largest output).
    """

    def __init__(
        self,
        name: str,
        transport: ByteTransport,
        ids: Sequence[int],
        models: Sequence[str],
        *,
        baud: int,
        return_delay_us: float = 0.0,
        rate_hz: float = 100.0,
        one_write: bool = True,
    ) -> None:
        """Make the reader; `models`: name of each id. Their registers are expected until `identify`.

        `return_delay_us`: the longest of the devices. `rate_hz`: rate of the loop.
        Raises ValueError for no ids or ids given twice, InvalidInput for an unknown model.
        """
        self._described = TURNAROUND + return_delay_us * 1e-6
        super().__init__(
            name,
            transport,
            ids,
            models,
            baud=baud,
            return_delay_s=self._described,
            rate_hz=rate_hz,
            one_write=one_write,
        )
        kinds = {id: model(each) for id, each in zip(ids, models, strict=True)}
        self._tables = {id: table_of(each) for id, each in kinds.items()}
        groups = {id: each.bulk_read for id, each in kinds.items()}
        self.cyclic: Dynamixel1CyclicRead = Dynamixel1CyclicRead(self.ids, groups, period=self._period)
        self.slow: Dynamixel1SlowRegisters = Dynamixel1SlowRegisters(self.ids)
        self._begin(self.slow)

    @property
    def tables(self) -> Mapping[int, RegisterTable]:
        """Register table by id; that of the expected model until `identify`."""
        return self._tables

    @property
    def lags(self) -> bool:
        """Return True if the cyclic reading takes longer than a cycle with the settings of the devices."""
        alone = sum(not each for each in self.cyclic.grouped.values())
        delay = self.line.return_delay_s - TURNAROUND
        return Dynamixel1Cycle(len(self.ids), alone, self.line.baud, delay).seconds > self._period

    def block(self, place: int) -> tuple[int, int]:
        """Return address and size of the cyclic block of one device."""
        return START, SIZE

    def explain(self, error: int) -> str:
        """Return the meaning of the error byte of a status."""
        return explain(error)

    def _exchange(self, query: Query) -> SerialTransaction:
        if isinstance(query, PingRequest):
            # A ping whose reply reports low voltage equals its own echo; a read of 4 bytes does not.
            query = ReadRequest((query.id,), *IDENTITY)
        return group_transaction(query.ids, query.address, query.size, self._answers_groups)

    def _transaction(self, query: Query) -> SerialTransaction:
        return self._exchange(query) if self.cyclic.trouble else super()._transaction(query)

    def _answers_groups(self, id: int) -> bool:
        """Return True if a bulk read may ask the device: a silent one would silence those behind it."""
        there = id in self.ids and bool(self.cyclic.attendance.asked[self.ids.index(id)])
        return there and not self.cyclic.trouble and self.cyclic.grouped[id]

    def _fold(self, query: ReadRequest, reply: PendingReply) -> None:
        self.slow.errors = dict(zip(reply.ids, reply.error.tolist(), strict=True))
        super()._fold(query, reply)

    # --------------------------------------------------------------------------- scripts

    def identify(self, *, patient: bool = False) -> Script[tuple[IdentifiedDevice, ...]]:
        """Read model, firmware and settings of every id; return the devices that reply, in order of `ids`.

        From then on register names are those of the model found, bulk reads go to the devices that answer
        them, and the longest return delay found is waited for. `patient`: as in `BusReader.identify`.
        """
        self.line.late_replies.delays.clear()
        before = self.line.return_delay_s
        self.line.return_delay_s = max(TURNAROUND + LONGEST, before) if patient else before
        grouped = dict(self.cyclic.grouped)
        try:
            found = yield from identify(self, self.cyclic.grouped.__setitem__)
            grouped |= {id: each.grouped for id, each in found.items()}
        finally:
            self.line.return_delay_s = before
            self._known = {}
        for id, each in found.items():
            self._tables[id] = each.table
            self.devices[id] = each.device
        delays = [each.device.settings.get("return_delay_time", 0) for each in found.values()]
        if delays:
            self.line.return_delay_s = max(self._described, TURNAROUND + 2e-6 * max(delays))
        self.cyclic.grouped = grouped
        self.cyclic.rebuild()
        if patient:
            self.cyclic.begin_anew()
        self._schedule()
        return tuple(found[id].device for id in self.ids if id in found)

    def read(self, id: int, name: str) -> Script[RegisterAddress]:
        """Read one register by its name; `hardware_error_status` is the error byte of a reply."""
        if name != ERRORS:
            return (yield from super().read(id, name))
        self.table(id)
        errors = yield from self.errors((id,))
        return RegisterAddress(name, IDENTITY[0], 1, errors[id], False)

    def errors(self, ids: Sequence[int]) -> Script[dict[int, int]]:
        """Return the error bits of several devices that are their state. Raises NoReply."""
        found: dict[int, int] = {}
        waited = 0.0
        for _ in range(2):
            missing = [id for id in ids if id not in found]
            for part in slices(missing, self.slice_count(IDENTITY[1])):
                reply = yield ReadRequest(part, *IDENTITY)
                found.update({id: error & FAULT_BITS for id, error in reply.error.items()})
                waited += reply.waited
        silent = [id for id in ids if id not in found]
        if silent:
            raise NoReply(self.name, silent, waited, f"read of {ERRORS}")
        return found

    def keeps(self, id: int, name: str) -> bool:
        """Return True for EEPROM registers: addresses below 24. Raises KeyError."""
        return name != ERRORS and super().keeps(id, name)
