"""Contract of a reply under way, and of the packets that a line of any family carries."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Octets = NDArray[np.uint8]
BITS = 10  # per byte: start, 8 data, stop


def wire(count: int, baud: int) -> float:
    """Return the time (s) of `count` bytes on the wire (8N1)."""
    return count * BITS / baud


class LinePacket(Protocol):
    """Whole packet with a right checksum."""

    @property
    def id(self) -> int:
        """Id of the sender or receiver."""

    @property
    def is_status(self) -> bool:
        """True if it may be a status; False if it is certainly an instruction."""

    @property
    def data(self) -> bytes:
        """Bytes of a status behind its error byte."""

    @property
    def octets(self) -> int:
        """Bytes of the packet on the wire."""


class PacketFramer(Protocol):
    """Search for packets in a stream of untrusted bytes; `status`: True finds statuses only, None both."""

    def __call__(self, data: bytes | bytearray | memoryview, *, status: bool | None) -> Sequence[LinePacket]:
        """Return the whole sound packets in `data`, in order."""


class PendingReply(Protocol):
    """Reply under way."""

    ids: tuple[int, ...]
    size: int  # data bytes of each device
    expected: int  # bytes of the whole reply, nothing stuffed
    heard: NDArray[np.bool_]  # (m,) data received whole, and not as part of an error
    error: Octets  # (m,) error byte of each status, with or without data; 0: no status
    data: Octets  # (m, size), zero where `heard` is False; valid until the next `start`
    answered: NDArray[np.bool_]  # (m,) a status came, with data or with an error alone
    whole: bool  # `heard` of all devices
    strays: int  # received bytes that are no part of the reply
    first: bytes  # first bytes of an irregular reply (an echo of the request begins there)

    @property
    def unasked(self) -> Sequence[LinePacket]:
        """Whole sound packets among the strays."""

    def start(self) -> None:
        """Discard the previous reply."""

    def receive_buffer(self) -> memoryview:
        """Return the buffer for the next bytes; never empty before the reply is complete."""

    def take(self, count: int) -> bool:
        """Process `count` bytes put into `receive_buffer()`; True when the reply is complete."""

    def end(self) -> None:
        """Settle the result: no more bytes follow."""
