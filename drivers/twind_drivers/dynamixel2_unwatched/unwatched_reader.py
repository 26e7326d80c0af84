"""Reader of a bus of XL-320 or PRO -R: cyclic reading, slow registers, identification.

Runs in the loop's one thread. Accepts only queries: a mirror has no object that can write.
"""

from collections.abc import Mapping, Sequence

from twind_drivers.bus import IdentifiedDevice, Query, Script
from twind_drivers.byte_transport import ByteTransport
from twind_drivers.dynamixel import packet
from twind_drivers.dynamixel2_unwatched.unwatched_cyclic_read import UnwatchedCyclicRead
from twind_drivers.dynamixel2_unwatched.unwatched_identification import identify
from twind_drivers.dynamixel2_unwatched.unwatched_models import model
from twind_drivers.dynamixel2_unwatched.unwatched_packets import PROTOCOL2, plain_transaction
from twind_drivers.dynamixel2_unwatched.unwatched_registers import UnwatchedLayout, layout_of
from twind_drivers.dynamixel2_unwatched.unwatched_slow_registers import UnwatchedSlowRegisters
from twind_drivers.half_duplex.half_duplex_transactor import SerialTransaction
from twind_drivers.half_duplex.pending_reply import wire
from twind_drivers.half_duplex.register_table import RegisterTable
from twind_drivers.half_duplex.table_reader import TableReader

LONGEST = 0.00051  # s of return delay, 255 steps


class UnwatchedReader(TableReader):
    """Reader of the devices `ids` of one bus. Arrays are (m,), in the order of `ids`, in raw units.

    All devices have one table. Effort is the load of an XL-320 (0.1 %), the current of a PRO -R.
    """

    codec = PROTOCOL2

    def __init__(
        self,
        name: str,
        transport: ByteTransport,
        ids: Sequence[int],
        models: Sequence[str],
        *,
        baud: int,
        return_delay_us: float = 500.0,
        rate_hz: float = 100.0,
        one_write: bool = True,
    ) -> None:
        """Make the reader; `models`: name of each id. `return_delay_us`: the longest of the devices.

        Raises ValueError for no ids, ids given twice, or models of two tables; InvalidInput: unknown model.
        """
        self._described = return_delay_us * 1e-6
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
        found = {model(each).table for each in models}
        if len(found) != 1:
            raise ValueError(f"{name}: models of one register table share a bus, got {', '.join(models)}")
        [self.kind] = found
        self.layout: UnwatchedLayout = layout_of(self.kind)
        self._tables = dict.fromkeys(self.ids, self.layout.table)
        self.cyclic: UnwatchedCyclicRead = UnwatchedCyclicRead(self.ids, self.layout)
        self._begin(UnwatchedSlowRegisters(self.ids, self.layout))

    @property
    def tables(self) -> Mapping[int, RegisterTable]:
        """Register table by id."""
        return self._tables

    @property
    def lags(self) -> bool:
        """Return True if the cyclic reading takes longer than a cycle with the settings of the devices."""
        size = 14 + len(self.ids) * (self.overhead + self.layout.row.itemsize + 1)
        delays = len(self.ids) * self.line.return_delay_s
        return wire(size, self.line.baud) + delays > self._period

    def block(self, place: int) -> tuple[int, int]:
        """Return address and size of the cyclic block of one device."""
        return self.layout.start, self.layout.row.itemsize

    def explain(self, error: int) -> str:
        """Return the meaning of the error byte of a status."""
        return packet.explain(error)

    def _exchange(self, query: Query) -> SerialTransaction:
        return plain_transaction(query)

    def identify(self, *, patient: bool = False) -> Script[tuple[IdentifiedDevice, ...]]:
        """Read model, firmware and settings of every id; return the devices that reply, in order of `ids`.

        The longest return delay found is waited for from then on. `patient`: as in `BusReader.identify`.
        """
        self.line.late_replies.delays.clear()
        before = self.line.return_delay_s
        self.line.return_delay_s = max(LONGEST, before) if patient else before
        try:
            found = yield from identify(self, self.kind)
        finally:
            self.line.return_delay_s = before
        self.devices.update(found)
        delays = [each.settings.get("return_delay_time", 0) for each in found.values()]
        self.line.return_delay_s = max(self._described, 2e-6 * max(delays, default=0))
        if patient:
            self.cyclic.begin_anew()
        self._schedule()
        return tuple(found[id] for id in self.ids if id in found)
