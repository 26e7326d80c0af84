"""Search for the servos of one family: packets, baud rates, and identification. Pure.

A family has one `ScanProtocol`. Everything here only reads, but for `write`, which a scan never uses.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

from twind_drivers.half_duplex.pending_reply import LinePacket

OLD_PING = bytes((0xFF, 0xFF, 0xFE, 0x02, 0x01, 0xFE))  # protocol 1.0, to all; sum inverted (e-manual)


class ScanStatus(LinePacket, Protocol):
    """Sound status."""

    @property
    def error(self) -> int:
        """Its error byte."""


class StatusFramer(Protocol):
    """Search for packets in received bytes; `status`: True finds statuses only, None both."""

    def __call__(self, data: bytes | bytearray | memoryview, *, status: bool | None) -> Sequence[ScanStatus]:
        """Return the whole sound packets in `data`, in order."""


class ServoRegister(Protocol):
    """One register of a servo."""

    @property
    def key(self) -> str:
        """Name in snake case."""

    @property
    def address(self) -> int:
        """First address."""

    @property
    def size(self) -> int:
        """Bytes."""

    @property
    def end(self) -> int:
        """First address behind it."""

    @property
    def eeprom(self) -> bool:
        """True if it survives power-off."""

    def encode(self, value: int) -> bytes:
        """Return the bytes of a value. Raises OverflowError."""

    def decode(self, data: bytes) -> int:
        """Return the value in the first bytes of `data`."""

    def check(self, value: int) -> None:
        """Raise ValueError, with the bound, for a value that may not be written."""


class ServoTable(Protocol):
    """Registers of one model."""

    def __contains__(self, name: str) -> bool: ...

    def __iter__(self) -> Iterator[str]: ...

    def __getitem__(self, name: str) -> ServoRegister: ...


@dataclass(frozen=True, slots=True)
class ServoIdentity:
    """Identity that a servo reports. `table` None: no table has this model and firmware."""

    model: int
    model_name: str | None
    firmware: int
    table: ServoTable | None


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanProtocol:
    """Search for the servos of one family."""

    kind: str  # of its buses
    bauds: tuple[int, ...]  # rates that a servo can have, the most usual first
    last_id: int
    overhead: int  # bytes of a status without data
    delay: float  # s: the longest return delay that a servo can be set to
    find_packets: StatusFramer
    ping: Callable[[int], bytes]  # a request that every servo with this id answers
    ping_size: int  # data bytes of its reply
    read: Callable[[int, int, int], bytes]  # id, address, size
    write: Callable[[int, int, bytes], bytes]  # id, address, data
    # s per id of a broadcast ping beside its wire time; 0: its replies would collide, ids are asked singly.
    slot: float
    line_probe: bytes  # request that no servo of the family answers: what comes is echo, or another kind
    identity: tuple[int, int]  # address and size of what `identify` reads; size 0: the reply to a ping
    # Identification by id and those bytes; None: a servo of another family.
    identify: Callable[[int, bytes], ServoIdentity | None]
    fault_bits: int  # of the error byte: those that are a state; 0: a register has the state
    explain: Callable[[int], str]  # meaning of an error state, in words
