"""Probing of a wire with unknown devices: one request at a time, and every byte that comes back. Blocks.

For tools that own the port alone. It sends pings and reads only: there is no way to write through it.
"""

from collections.abc import Sequence

import numpy as np

from twind_drivers.byte_transport import ByteTransport
from twind_drivers.clock import Clock
from twind_drivers.half_duplex.checksum_packet import BROADCAST
from twind_drivers.half_duplex.half_duplex_transactor import HalfDuplexTransactor, SerialTransaction
from twind_drivers.half_duplex.pending_reply import LinePacket
from twind_drivers.servo_tools.scan_protocol import ScanProtocol, ScanStatus

SLACK = 0.002  # s that an answer may take beyond its wire time
HELD = 4096  # bytes kept of one answer, and taken at once


class ProbeWindow:
    """Everything that came within one window: sound statuses, and the bytes that were none."""

    def __init__(self, expected: int) -> None:
        """`expected`: bytes to allow wire time for."""
        self.ids: tuple[int, ...] = ()
        self.size = 0
        self.expected = expected
        self.strays = 0
        self.whole = False
        self.first = b""
        self.unasked: Sequence[LinePacket] = ()  # always empty: all received packets are kept
        self.heard = self.answered = np.zeros(0, np.bool_)
        self.error = self.data = np.zeros(0, np.uint8)
        self.statuses: Sequence[ScanStatus] = ()
        self.raw = bytearray()
        self.late = False  # its last byte came later than any setting of a device explains
        self._received = 0
        self._buffer = memoryview(bytearray(HELD))

    def start(self) -> None:
        """Do nothing: each window is used once."""

    def receive_buffer(self) -> memoryview:
        """Return the buffer for the next bytes."""
        return self._buffer

    def take(self, count: int) -> bool:
        """Take `count` bytes; always False, as the window stays open for other devices that may answer."""
        self._received += count
        if len(self.raw) < HELD:
            self.raw += self._buffer[:count]
        return False

    def end(self) -> None:
        """Do nothing: `settle` judges the bytes."""

    def settle(self, protocol: ScanProtocol, echo: int) -> None:
        """Find the statuses behind `echo` bytes; bytes that form none count as stray."""
        del self.raw[:echo]
        self.statuses = protocol.find_packets(self.raw, status=True)
        self.strays = self._received - echo - sum(each.octets for each in self.statuses)


class PortProber:
    """Prober of one port at one baud rate. Every method may raise PortError."""

    def __init__(
        self,
        transport: ByteTransport,
        clock: Clock,
        baud: int,
        protocol: ScanProtocol,
        *,
        timer: float = 0.0,
    ) -> None:
        """Make the prober; `timer` (s): the adapter's latency timer, by which every window is longer."""
        self.transport = transport
        self.baud = baud
        self.protocol = protocol
        self.echo = False  # the adapter returns what is sent; known after the first answer
        self._clock = clock
        self._slack = SLACK + timer
        self._line = HalfDuplexTransactor(
            transport.name,
            transport,
            baud=baud,
            return_delay_s=protocol.delay,
            slack=self._slack,
            find_packets=protocol.find_packets,
        )

    def roll_call(self, last: int) -> ProbeWindow:
        """Send a broadcast ping and wait until the slot of id `last` is over: up to 0.8 s."""
        slots = last + 1
        size = self.protocol.overhead + self.protocol.ping_size
        self._line.slack = self._slack + slots * self.protocol.slot
        window = self._ask(self.protocol.ping(BROADCAST), slots * size, delays=1)
        self._line.slack = self._slack
        return window

    def ping(self, id: int, patience: float = 0.0) -> ProbeWindow:
        """Ping this id; return every device that answers, up to `patience` (s) later than it should."""
        return self._exchange(self.protocol.ping(id), self.protocol.ping_size, patience)

    def read(self, id: int, address: int, size: int, patience: float = 0.0) -> ProbeWindow:
        """Read `size` bytes from `address` at this id; return every device that answers, as `ping`."""
        return self._exchange(self.protocol.read(id, address, size), size, patience)

    def probe_line(self) -> ProbeWindow:
        """Send the request that no device of the family answers."""
        return self._exchange(self.protocol.line_probe, 0)

    def listen(self, seconds: float) -> int:
        """Collect bytes that come without a request."""
        self.transport.drain()
        self._clock.sleep_until(self._clock.now() + seconds)
        return self.transport.drain()

    def _exchange(self, request: bytes, size: int, patience: float = 0.0) -> ProbeWindow:
        """Leave time for the replies of two devices, each with `size` data bytes."""
        reply = self.protocol.overhead + size
        self._line.slack = self._slack + patience
        window = self._ask(request, 2 * reply, delays=2, like=reply)
        self._line.slack = self._slack
        window.late = self._line.received > self._line.deadline - patience
        return window

    def _ask(self, request: bytes, expected: int, *, delays: int, like: int = 0) -> ProbeWindow:
        """Send a request. `like`: bytes of one status; a request of that size is no sign of an echo.

        A status of the framing `FF FF` can be equal to its request.
        """
        window = ProbeWindow(expected)
        self._line.send(SerialTransaction(request, window, delays), self._clock.now())
        while not self._line.feed(self._clock.now()) and self._clock.now() < self._line.deadline:
            self._clock.wait([self.transport], self._line.deadline)
        self._line.end()
        returned = window.raw.startswith(request)
        self.echo |= returned and len(request) != like
        window.settle(self.protocol, len(request) if returned and self.echo else 0)
        return window
