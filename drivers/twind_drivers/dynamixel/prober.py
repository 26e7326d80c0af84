"""Probing of a wire with unknown devices: one request at a time, and every byte that comes back. Blocks.

For tools that own the port alone. It sends pings and reads only: there is no way to write through it.
"""

from collections.abc import Sequence

import numpy as np

from twind_drivers.byte_transport import ByteTransport
from twind_drivers.clock import Clock
from twind_drivers.dynamixel import packet
from twind_drivers.dynamixel.packet import LAST_ID, STATUS_OVERHEAD, Framer, Packet
from twind_drivers.half_duplex.half_duplex_transactor import HalfDuplexTransactor, SerialTransaction

LONGEST_DELAY = 508e-6  # s: the largest return delay a device can be set to (register 9: 254 x 2 us)
SLACK = 0.002  # s that an answer may take beyond its wire time
OLD_PING = bytes((0xFF, 0xFF, 0xFE, 0x02, 0x01, 0xFE))  # protocol 1.0, to all; sum inverted (e-manual)
HELD = 4096  # bytes kept of one answer, and taken at once
PING_DATA = 3  # bytes of a reply to a ping: model number 2, firmware 1
# s per id of a broadcast ping, beside its wire time. Devices reply in the order of their ids. Id 5 alone did
# not reply within 10 ms at 2 Mbaud, but within 50 ms (Dynamixel2Arduino #106). Less than 3 ms misses high ids
# (DynamixelSDK, `broadcastPing`).
SLOT = 0.003


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
        self.unasked: Sequence[Packet] = ()  # always empty: all received packets are kept
        self.heard = self.answered = np.zeros(0, np.bool_)
        self.error = self.data = np.zeros(0, np.uint8)
        self.statuses: list[Packet] = []
        self.raw = bytearray()
        self.late = False  # its last byte came later than any setting of a device explains
        self._buffer = memoryview(bytearray(HELD))
        self._framer = Framer(status=True)

    def start(self) -> None:
        """Do nothing: each window is used once."""

    def receive_buffer(self) -> memoryview:
        """Return the buffer for the next bytes."""
        return self._buffer

    def take(self, count: int) -> bool:
        """Take `count` bytes; always False, as the window stays open for other devices that may answer."""
        if len(self.raw) < HELD:
            self.raw += self._buffer[:count]
        self.statuses += self._framer.feed(self._buffer[:count])
        return False

    def end(self) -> None:
        """End the window: bytes that form no status by now count as stray."""
        self._framer.clear()
        self.strays = self._framer.discarded


class PortProber:
    """Prober of one port at one baud rate. Every method may raise PortError."""

    def __init__(self, transport: ByteTransport, clock: Clock, baud: int, *, timer: float = 0.0) -> None:
        """Make the prober; `timer` (s): the adapter's latency timer, by which every window is longer."""
        self.transport = transport
        self.baud = baud
        self.echo = False  # the adapter returns what is sent; known after the first answer
        self._clock = clock
        self._slack = SLACK + timer
        self._line = HalfDuplexTransactor(
            transport.name,
            transport,
            baud=baud,
            return_delay_s=LONGEST_DELAY,
            slack=self._slack,
            find_packets=packet.find_packets,
        )

    def roll_call(self, last: int = LAST_ID) -> ProbeWindow:
        """Send a broadcast ping and wait until the slot of id `last` is over: up to 0.8 s."""
        slots = last + 1
        self._line.slack = self._slack + slots * SLOT
        window = self._ask(packet.ping(packet.BROADCAST), slots * (STATUS_OVERHEAD + PING_DATA), delays=1)
        self._line.slack = self._slack
        return window

    def ping(self, id: int, patience: float = 0.0) -> ProbeWindow:
        """Ping this id; return every device that answers, up to `patience` (s) later than it should."""
        return self._exchange(packet.ping(id), PING_DATA, patience)

    def read(self, id: int, address: int, size: int, patience: float = 0.0) -> ProbeWindow:
        """Read `size` bytes from `address` at this id; return every device that answers, as `ping`."""
        return self._exchange(packet.read(id, address, size), size, patience)

    def old_ping(self) -> ProbeWindow:
        """Send a protocol 1.0 ping to all: devices of protocol 2.0 take it for noise."""
        return self._exchange(OLD_PING, 0)

    def listen(self, seconds: float) -> int:
        """Collect bytes that come without a request."""
        self.transport.drain()
        self._clock.sleep_until(self._clock.now() + seconds)
        return self.transport.drain()

    def _exchange(self, request: bytes, size: int, patience: float = 0.0) -> ProbeWindow:
        """Leave time for the replies of two devices, each with `size` data bytes."""
        self._line.slack = self._slack + patience
        window = self._ask(request, 2 * (STATUS_OVERHEAD + size), delays=2)
        self._line.slack = self._slack
        window.late = self._line.received > self._line.deadline - patience
        return window

    def _ask(self, request: bytes, expected: int, *, delays: int) -> ProbeWindow:
        window = ProbeWindow(expected)
        self._line.send(SerialTransaction(request, window, delays), self._clock.now())
        while not self._line.feed(self._clock.now()) and self._clock.now() < self._line.deadline:
            self._clock.wait([self.transport], self._line.deadline)
        self._line.end()
        if window.raw.startswith(request):
            self.echo = True
            window.strays -= len(request)
            del window.raw[: len(request)]
        return window
