"""A reader of servos with registers, as writers use it."""

from collections.abc import Mapping, Sequence
from typing import Protocol

from twind_drivers.bus import Script, SlowRegisterValues
from twind_drivers.device_registers import RegisterAddress
from twind_drivers.half_duplex.half_duplex_transactor import HalfDuplexTransactor
from twind_drivers.half_duplex.host_watchdog import HostWatchdog
from twind_drivers.half_duplex.line_codec import LineCodec
from twind_drivers.half_duplex.register_table import RegisterTable
from twind_drivers.half_duplex.slow_register_slices import SlowRegisterSlices


class RegisterReader(Protocol):
    """Reader as its writer uses it."""

    name: str
    ids: tuple[int, ...]
    line: HalfDuplexTransactor
    registers: SlowRegisterValues
    watchdog: HostWatchdog
    codec: LineCodec

    @property
    def slow(self) -> SlowRegisterSlices:
        """Slow registers and their schedule."""

    @property
    def tables(self) -> Mapping[int, RegisterTable]:
        """Register table by id."""

    def table(self, id: int) -> RegisterTable:
        """Return the register table of a device. Raises KeyError."""

    def collect(self, ids: Sequence[int], address: int, size: int) -> Script[Mapping[int, bytes]]:
        """Read one block of several devices. Raises NoReply, DeviceRefused."""

    def values(self, ids: Sequence[int], address: int, size: int) -> Script[dict[int, Mapping[str, int]]]:
        """Read one block of several devices; return its registers by id. Raises NoReply."""

    def read(self, id: int, name: str) -> Script[RegisterAddress]:
        """Read one register by its name."""
