"""Transactions on one half-duplex line: one at a time, the packets that leave before it, its deadline.

Does the I/O through a `Transport`; time is an argument. It also classifies bytes that belong to no request
(FOREIGN_TRAFFIC).
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from math import inf

from twind_drivers.bus import ByteTransport, OutputQueueFull
from twind_drivers.dynamixel.packet import HEADER, STATUS, Framer, Packet
from twind_drivers.dynamixel.replies import PendingReply
from twind_drivers.dynamixel.serial_cycle_budget import wire

LATE = 1.0  # s that an answer may be late and is still known as one


@dataclass(frozen=True, slots=True)
class SerialTransaction:
    """One request and the reply expected for it."""

    packet: bytes
    reply: PendingReply | None  # None: never answered
    delays: int  # how many return delays pass before the last byte
    extra: float = 0.0  # s that pass besides, of a device that takes longer than the servos

    @property
    def size(self) -> int:
        """Bytes on the wire, both directions, nothing stuffed."""
        return len(self.packet) + (self.reply.expected if self.reply else 0)


class HalfDuplexTransactor:
    """The wire of one bus.

    `goals` leave with the next cyclic request. `urgent` leaves with the next write of any kind; goals that
    were set before it left are dropped. Until an answer shows that it left, it is sent again when what waits
    in the port is thrown away.

    `foreign` counts whole sound packets that nobody asked for. A status of a device that missed an answer
    within the last second is not one of them: it may be that answer. Nor is any of `sensors`, ids of devices
    that only tell: those are `late`, and no strays; and what comes behind the answer of such a device and
    before the next request is its own, too. `echo`: the adapter gives back what we send; recognised by a
    packet of ours in the answer, from then on taken off each answer.
    """

    def __init__(
        self,
        name: str,
        transport: ByteTransport,
        *,
        baud: int,
        return_delay_s: float,
        slack: float,
        one_write: bool = True,
        sensors: Collection[int] = (),
    ) -> None:
        """`one_write`: what is pending and the request leave in one system call, else in two."""
        self.name = name
        self.transport = transport
        self.baud = baud
        self.slack = slack
        self.return_delay_s = return_delay_s
        self.one_write = one_write
        self._sensors = frozenset(sensors)
        self.urgent = b""
        self.goals = b""
        self._leaving = b""  # urgent, written, and not yet known to have left the port
        self.sent = self.received = self.deadline = -inf  # s
        self.strays = 0  # bytes dropped in the present transaction
        self.foreign = 0  # packets; whoever reports it sets it back
        self.late: list[int] = []  # data bytes of each status of a sensor out of its turn; the same
        self._told = False  # the last transaction asked a sensor
        self.echo = False
        self.exchange: SerialTransaction | None = None
        self._done = True
        self._busy = -inf  # s, until when our own bytes are still going out
        self._out: tuple[bytes, bytes] = (b"", b"")  # what was sent last
        self._echoed = bytearray()  # of that, what has come back; only with an echo
        self._owed: dict[int, float] = {}  # devices whose answer may still come late: s, until when
        self._late = bytearray()

    def span(self, exchange: SerialTransaction, extra: int = 0) -> float:
        """Return the bus time (s) that the transaction takes, with `extra` bytes before it."""
        return wire(exchange.size + extra, self.baud) + exchange.delays * self.return_delay_s + exchange.extra

    def send(self, exchange: SerialTransaction, now: float, *, goals: bool = False) -> None:
        """Begin a transaction: late bytes of the last one are dropped, then everything leaves.

        Raises PortError; PortFull when more than the last packet waits in the port (TX_BACKLOG), or it does
        not take all of this one. Goals that could not be sent are dropped, an urgent packet is sent later.
        """
        try:
            self._send(exchange, now, goals=goals)
        except OutputQueueFull:
            self.exchange = None
            self._done = True
            self.urgent = self.urgent or self._leaving
            self._busy = -inf
            raise

    def _send(self, exchange: SerialTransaction, now: float, *, goals: bool) -> None:
        self.exchange = None
        self._done = True
        self.strays = self.transport.drain(self._late)
        if self.strays:
            self._look_back()
        self._told = False
        lead = self.urgent or (self.goals if goals else b"")
        if lead:
            self.goals = b""
        if self.transport.holds:
            self._require_room()
        if exchange.reply is not None:
            exchange.reply.start()
        self.exchange = exchange
        self._done = exchange.reply is None
        self.sent = now
        self._out = (lead, exchange.packet)
        if self.echo:
            self._echoed.clear()
        if lead and not self.one_write:
            self.transport.write(lead)
            self.transport.write(exchange.packet)
        else:
            self.transport.write(lead + exchange.packet)
        if self.urgent:
            self._leaving = self.urgent
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
        if self.echo and not self._past_echo(reply):
            return self._done
        count = self.transport.read_into(reply.receive_buffer())
        if count:
            self.received = now
            self._done = reply.take(count)
        return self._done

    def end(self) -> SerialTransaction | None:
        """End the transaction; what it heard stands in the exchange's reply until the next one."""
        exchange = self.exchange
        self.exchange = None
        self._done = True
        reply = exchange.reply if exchange is not None else None
        if reply is not None:
            self._told = bool(self._sensors) and self._sensors.issuperset(reply.ids)
            reply.end()
            self.strays += reply.strays
            if self._leaving and reply.answered.any():
                self._leaving = b""
            if reply.unasked:
                self._judge(reply.unasked, reply.first)
            if self._owed or not reply.whole:
                self._remember(reply)
        return exchange

    # --------------------------------------------------------------------------- the rare cases

    def _require_room(self) -> None:
        waiting = self.transport.backlog()
        most = len(self._out[0]) + len(self._out[1])
        if waiting > most:
            self.transport.flush()
            raise OutputQueueFull(self.name, waiting, most)

    def _look_back(self) -> None:
        """Classify bytes that came after the last transaction had ended."""
        self._judge(Framer(status=None).feed(self._late), bytes(self._late))
        self._late.clear()
        if self._told:
            self.strays = 0

    def _judge(self, packets: Sequence[Packet], first: bytes) -> None:
        """`first`: what came first in this window; where our own packets stand there, they are an echo."""
        sent = b"".join(self._out)
        own = Framer(status=False).feed(sent)
        ours = first.startswith(sent) or (len(first) > len(HEADER) and sent.startswith(first))
        if own and ours and list(packets[: len(own)]) == own:
            self.echo = True
            packets = packets[len(own) :]
            self.strays -= len(sent)
        told = [each for each in packets if each.instruction == STATUS and each.id in self._sensors]
        self.late += [len(each.data) for each in told]
        self.strays = max(0, self.strays - sum(each.octets for each in told))
        known = self._owed.keys() | self._sensors
        self.foreign += sum(each.instruction != STATUS or each.id not in known for each in packets)

    def _remember(self, reply: PendingReply) -> None:
        """Record the ids that missed this reply, each with the time (s) until which it may come late."""
        self._owed = {id: until for id, until in self._owed.items() if until > self.sent}
        missed = [id for id, ok in zip(reply.ids, reply.answered.tolist(), strict=True) if not ok]
        self._owed.update(dict.fromkeys(missed, self.sent + LATE))

    def _past_echo(self, reply: PendingReply) -> bool:
        """Take our own bytes off the front; others than ours belong to the answer."""
        sent = b"".join(self._out)
        left = len(sent) - len(self._echoed)
        if left:
            part = bytearray(left)
            count = self.transport.read_into(memoryview(part))
            self._echoed += part[:count]
            if not sent.startswith(self._echoed):
                self.echo = False
                reply.receive_buffer()[: len(self._echoed)] = self._echoed
                self._done = reply.take(len(self._echoed))
                return False
            return count == left
        return True
