"""Reader of a Feetech bus: cyclic reading, slow registers, identification.

Runs in the loop's one thread. Accepts only queries: a mirror has no object that can write.
"""

from collections.abc import Mapping, Sequence

from twind_drivers.bus import (
    IdentifiedDevice,
    PingRequest,
    Query,
    ReadRequest,
    Script,
)
from twind_drivers.byte_transport import ByteTransport
from twind_drivers.feetech.feetech_budget import DELAY, SHORT, WHOLE, cycle_seconds, cyclic_size
from twind_drivers.feetech.feetech_cyclic_read import START, FeetechCyclicRead, group_transaction
from twind_drivers.feetech.feetech_identification import identify
from twind_drivers.feetech.feetech_models import model
from twind_drivers.feetech.feetech_packet import explain
from twind_drivers.feetech.feetech_registers import IDENTITY, RegisterMap, register_map
from twind_drivers.feetech.feetech_slow_registers import FeetechSlowRegisters
from twind_drivers.half_duplex.half_duplex_transactor import SerialTransaction
from twind_drivers.half_duplex.table_reader import TableReader

LONGEST = 0.000508  # s from a request to its reply, where 254 steps of register 7 have a function


class FeetechReader(TableReader):
    """Reader of the devices `ids` of one bus. Arrays are (m,), in the order of `ids`, in raw units.

    Effort is the current (6.5 mA) where a device of the bus has it, else the PWM duty (0.1 %).
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
        slack: float | None = None,
        one_write: bool = True,
    ) -> None:
        """Make the reader; `models`: name of each id. Their registers are expected until `identify`.

        `return_delay_us`: the longest of the devices; 0: 100 us. `rate_hz`: rate of the loop. `slack` (s):
        time that a reply may take beyond its wire time; None: 2 ms, or half a period where that is less.

        Raises ValueError for no ids or ids given twice, InvalidInput for an unknown model.
        """
        super().__init__(
            name,
            transport,
            ids,
            models,
            baud=baud,
            return_delay_s=return_delay_us * 1e-6 or DELAY,
            rate_hz=rate_hz,
            one_write=one_write,
            slack=slack,
        )
        self.maps: dict[int, RegisterMap] = {
            id: register_map(model(each).map) for id, each in zip(ids, models, strict=True)
        }
        self.confirmed: dict[int, bool] = dict.fromkeys(ids, False)  # the map is the firmware's
        maps = [self.maps[id] for id in self.ids]
        has_current = ["present_current" in each for each in maps]
        self._size = cyclic_size(has_current, self._seconds, self._period)
        self.cyclic: FeetechCyclicRead = FeetechCyclicRead(
            self.ids, maps, currents=any(has_current), whole=self._size == WHOLE, period=self._period
        )
        self._begin(FeetechSlowRegisters(self.ids))

    @property
    def lags(self) -> bool:
        """Return True if the cyclic reading takes longer than a cycle with the settings of the devices."""
        return self._seconds(self._size) > self._period

    def _seconds(self, size: int) -> float:
        alone = sum(not self.maps[id].sync_read for id in self.ids)
        return cycle_seconds(len(self.ids), alone, size, baud=self.line.baud, delay=self.line.return_delay_s)

    @property
    def tables(self) -> Mapping[int, RegisterMap]:
        """Register map by id; that of the expected model until `identify`."""
        return self.maps

    def block(self, place: int) -> tuple[int, int]:
        """Return address and size of the cyclic block of one device."""
        return START, SHORT

    def explain(self, error: int) -> str:
        """Return the meaning of the error byte of a status."""
        return explain(error)

    def _exchange(self, query: Query) -> SerialTransaction:
        if isinstance(query, PingRequest):
            # A ping whose reply reports low voltage equals its own echo; a read of 5 bytes does not.
            query = ReadRequest((query.id,), *IDENTITY)
        return group_transaction(query.ids, query.address, query.size, self._answers_groups)

    def _answers_groups(self, id: int) -> bool:
        return self.cyclic.grouped.get(id, False)

    # --------------------------------------------------------------------------- scripts

    def identify(self, *, patient: bool = False) -> Script[tuple[IdentifiedDevice, ...]]:
        """Read firmware and settings of every id; return the devices that reply, in order of `ids`.

        From then on register names are those of the firmware found, and sync reads go to the devices that
        answer them. `patient`: as in `BusReader.identify`; afterwards the cyclic reading starts anew.
        """
        self.line.late_replies.delays.clear()
        before = self.line.return_delay_s
        self.line.return_delay_s = max(LONGEST, before) if patient else before
        grouped = dict(self.cyclic.grouped)
        try:
            found = yield from identify(self, self.cyclic.grouped.__setitem__)
            grouped |= {id: each.grouped for id, each in found.items()}
        finally:
            self.line.return_delay_s = before
            self._known = {}
        for id, each in found.items():
            self.maps[id] = each.map
            self.confirmed[id] = True
            self.devices[id] = each.device
        self.cyclic.set_maps([self.maps[id] for id in self.ids], [grouped[id] for id in self.ids])
        if patient:
            self.cyclic.begin_anew()
        self._schedule()
        return tuple(found[id].device for id in self.ids if id in found)
