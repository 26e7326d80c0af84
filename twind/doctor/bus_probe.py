"""One transaction on a serial bus, read as soon as it arrives: delay and garbled bytes.

Pings and reads only: it cannot write.
"""

from typing import NamedTuple

from twind_drivers.bus import ByteTransport
from twind_drivers.clock import Clock
from twind_drivers.dynamixel import packet
from twind_drivers.dynamixel.half_duplex_transactor import HalfDuplexTransactor, SerialTransaction
from twind_drivers.dynamixel.prober import LONGEST_DELAY
from twind_drivers.dynamixel.replies import StatusReply

# s that an answer may take beside its wire time: a machine that is busy is no fault of a servo.
PATIENCE = 0.02


class ProbeReply(NamedTuple):
    """Reply of one servo to one ping or read."""

    data: bytes | None  # None: it did not answer, or with an error alone
    error: int  # error byte; bit 7: alert
    delay: float  # s from the question to the last byte, beside the wire's own time
    strays: int  # bytes that were no part of the answer
    answered: bool  # a status came, with data or with an error alone


class BusProbe:
    """One port at its present baud rate. Every method may raise PortError."""

    def __init__(self, transport: ByteTransport, clock: Clock, baud: int, *, timer: float = 0.0) -> None:
        """`timer` (s): the adapter's latency timer, by which every answer may be late."""
        self._transport = transport
        self._clock = clock
        self._line = HalfDuplexTransactor(
            transport.name, transport, baud=baud, return_delay_s=LONGEST_DELAY, slack=PATIENCE + timer
        )

    def ping(self, id: int) -> ProbeReply:
        """Ping one servo: model number (2 bytes) and firmware (1)."""
        return self._ask(packet.ping(id), StatusReply((id,), 3))

    def read(self, id: int, address: int, size: int) -> ProbeReply:
        """Read `size` bytes from `address` of one servo."""
        return self._ask(packet.read(id, address, size), StatusReply((id,), size))

    def _ask(self, request: bytes, reply: StatusReply) -> ProbeReply:
        exchange = SerialTransaction(request, reply, 1)
        self._line.send(exchange, self._clock.now())
        while not self._line.feed(self._clock.now()) and self._clock.now() < self._line.deadline:
            self._clock.wait([self._transport], self._line.deadline)
        took = self._clock.now() - self._line.sent
        self._line.end()
        wire = self._line.span(exchange) - LONGEST_DELAY
        heard = bool(reply.heard[0])
        data = reply.data[0].tobytes() if heard else None
        return ProbeReply(data, int(reply.error[0]), took - wire, self._line.strays, bool(reply.answered[0]))
