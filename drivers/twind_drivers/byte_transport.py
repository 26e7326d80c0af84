"""Byte stream under a bus, as the drivers of serial ports and slcan adapters use it."""

from typing import Protocol

from twind_drivers.bus import PortError, PortErrorCause, PortHandle


class ByteTransport(PortHandle, Protocol):
    """Byte stream to a bus: a serial port, or the in-process loopback of the virtual servos."""

    holds: bool  # written bytes may wait in it, and `backlog` counts them

    def write(self, data: bytes | bytearray | memoryview) -> None:
        """Send all of `data` in one system call. Raises PortError of kind LOST."""

    def read_into(self, buffer: memoryview) -> int:
        """Bytes taken without blocking; 0 if none are there. Raises PortError of kind LOST."""

    def drain(self, thrown: bytearray | None = None) -> int:
        """Discard received bytes; return their number and copy them to `thrown`. Called before each request.

        Without it a late reply would be taken for the reply to the next request.
        """

    def backlog(self) -> int:
        """Bytes written that have not left yet; 0 where that is unknown. Raises PortError of kind LOST."""

    def settle(self) -> None:
        """Wait until what the machine has received can be read; other programs may delay that."""

    def flush(self) -> None:
        """Throw away what has not left yet. Raises PortError of kind LOST."""


def output_full(port: str, waiting: int, most: int) -> PortError:
    """Build the error for a port whose output was dropped.

    `waiting`: bytes that were in it; `most`: bytes of the last packet.
    """
    return PortError(
        port,
        f"{waiting} bytes still wait in the output, the last packet had {most}: thrown away, nothing "
        "sent; is the adapter stuck, or slower than its baud rate says?",
        PortErrorCause.OUTPUT_FULL,
    )
