"""One half-duplex line: one transaction at a time, what is pending before it, its deadline.

Does the I/O through a `Transport`; time is an argument.
"""

from dataclasses import dataclass
from math import inf

from twind_drivers.bus import Transport
from twind_drivers.dynamixel.budget import wire
from twind_drivers.dynamixel.replies import Expected


@dataclass(frozen=True, slots=True)
class Exchange:
    """One request and what it should bring back."""

    packet: bytes
    reply: Expected | None  # None: never answered
    delays: int  # how many return delays pass before the last byte

    @property
    def size(self) -> int:
        """Bytes on the wire, both directions, nothing stuffed."""
        return len(self.packet) + (self.reply.expected if self.reply else 0)


class Line:
    """The wire of one bus.

    `goals` leave with the next cyclic request. `urgent` leaves with the next write of any kind; goals that
    were set before it left are dropped.
    """

    def __init__(
        self, name: str, transport: Transport, *, baud: int, return_delay_s: float, slack: float
    ) -> None:
        self.name, self.transport, self.baud, self.slack = name, transport, baud, slack
        self.return_delay_s = return_delay_s
        self.urgent = b""
        self.goals = b""
        self.sent = self.received = self.deadline = -inf  # s
        self.strays = 0  # bytes dropped in the present transaction
        self.exchange: Exchange | None = None
        self._done = True
        self._busy = -inf  # s, until when our own bytes are still going out

    def span(self, exchange: Exchange, extra: int = 0) -> float:
        """Bus time (s) that it takes, with `extra` bytes before it."""
        return wire(exchange.size + extra, self.baud) + exchange.delays * self.return_delay_s

    def send(self, exchange: Exchange, now: float, *, goals: bool = False) -> None:
        """Begin a transaction: late bytes of the last one are dropped, then everything leaves in one write.

        Raises PortError. Goals that could not be sent are dropped, an urgent packet stays until it is sent.
        """
        self.strays = self.transport.drain()
        lead = self.urgent or (self.goals if goals else b"")
        if lead:
            self.goals = b""
        if exchange.reply is not None:
            exchange.reply.start()
        self.exchange, self._done, self.sent = exchange, exchange.reply is None, now
        self.transport.write(lead + exchange.packet)
        self.urgent = b""
        begin = max(now, self._busy)
        self._busy = begin + wire(len(lead) + len(exchange.packet), self.baud)
        self.received = now
        self.deadline = begin + self.span(exchange, len(lead)) + (0.0 if self._done else self.slack)

    def feed(self, now: float) -> bool:
        """Take what has arrived; True when the transaction is complete. Raises PortError."""
        reply = self.exchange.reply if self.exchange else None
        if self._done or reply is None:
            return True
        count = self.transport.read_into(reply.room())
        if count:
            self.received = now
            self._done = reply.take(count)
        return self._done

    def end(self) -> Exchange | None:
        """End the transaction; what it heard stands in the exchange's reply until the next one."""
        exchange, self.exchange, self._done = self.exchange, None, True
        if exchange is not None and exchange.reply is not None:
            exchange.reply.end()
            self.strays += exchange.reply.strays
        return exchange
