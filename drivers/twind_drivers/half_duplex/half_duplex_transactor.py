"""Transactor of a half-duplex line: one transaction at a time, the packets ahead of it, its deadline.

Does the I/O through a `ByteTransport`; time is an argument. It also classifies bytes that belong to no
request (FOREIGN_TRAFFIC).
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from math import inf

from twind_drivers.bus import PortError, PortErrorCause
from twind_drivers.byte_transport import ByteTransport, output_full
from twind_drivers.half_duplex.late_replies import LateReplies
from twind_drivers.half_duplex.pending_reply import LinePacket, PacketFramer, PendingReply, wire

PATIENCE = 2  # silent devices that a chain goes past: each costs the slack
ECHO_START = 4  # first bytes of an echo that are enough to know it


@dataclass(frozen=True, slots=True)
class SerialTransaction:
    """Request and its expected reply.

    `then`: further requests for devices without group reads, each with the places in the reply of the devices
    that the request before it asks. It leaves when their replies are in, or when that request has had its
    time: a late reply of an earlier one is none of theirs. Two silent devices end the chain.
    """

    packet: bytes
    reply: PendingReply | None  # None: no reply follows
    delays: int  # number of return delays before the last byte
    extra: float = 0.0  # s, further delay of a device that is slower than the servos
    then: tuple[tuple[tuple[int, ...], bytes], ...] = ()

    @property
    def size(self) -> int:
        """Bytes on the wire, both directions, nothing stuffed."""
        size = len(self.packet) + (self.reply.expected if self.reply else 0)
        for _, each in self.then:
            size += len(each)
        return size


class HalfDuplexTransactor:
    """Transactor of one bus.

    `goals` leave with the next cyclic request. `urgent` leaves with the next write of any kind; goals set
    before that are dropped. It is sent again if the port's output is discarded before a reply shows that it
    has left.

    `foreign` counts whole sound packets without a request. A status of a device that missed a reply within
    the last second does not count: it may be that reply. A status of `sensors`, ids of read-only sensors,
    counts as `late` and not as stray. Bytes between a sensor's reply and the next request are its own, too.
    `echo`: the adapter returns what is sent. It is recognised by a sent packet in the reply, and from then on
    removed from each reply.
    """

    def __init__(
        self,
        name: str,
        transport: ByteTransport,
        *,
        baud: int,
        return_delay_s: float,
        slack: float,
        find_packets: PacketFramer,
        one_write: bool = True,
        sensors: Collection[int] = (),
    ) -> None:
        """Make the transactor; `one_write`: pending packets and request leave in one system call, else two.

        `return_delay_s`, `slack` (s): see `deadline` in `_send`. `find_packets`: of the line's protocol.
        """
        self.name = name
        self.transport = transport
        self.baud = baud
        self.slack = slack
        self.return_delay_s = return_delay_s
        self.one_write = one_write
        self._find_packets = find_packets
        self._sent_after: int  # requests of the chain that have left, behind the first
        self._passed: int  # silent devices that the chain went past
        self._sensors = frozenset(sensors)
        self.urgent = b""
        self.goals = b""
        self._leaving = b""  # urgent, written, and not yet known to have left the port
        self.sent = self.received = self.deadline = self._latest = -inf  # s
        self.strays = 0  # bytes dropped in the present transaction
        self.foreign = 0  # packets; the reader resets it when it reports them
        self.late: list[int] = []  # data bytes of each status of a sensor out of its turn; reset likewise
        self._sensor_read = False  # the last transaction read a sensor
        self.echo = False
        self._echoes = False  # `echo`, when the last transaction began
        self.exchange: SerialTransaction | None = None
        self._done: bool  # the reply of `exchange` is complete
        self._busy = -inf  # s, time until which sent bytes are on the wire
        self._out: list[bytes] = [b""]  # bytes of each write of the last transaction; its first has the lead
        self._echoed = bytearray()  # of the last write, the bytes returned by an echo
        self.late_replies = LateReplies()
        self._late = bytearray()

    def span(self, exchange: SerialTransaction) -> float:
        """Return the bus time (s) that the transaction takes."""
        return wire(exchange.size, self.baud) + exchange.delays * self.return_delay_s + exchange.extra

    def send(
        self, exchange: SerialTransaction, now: float, *, goals: bool = False, latest: float = -inf
    ) -> None:
        """Begin a transaction: drop late bytes of the last one, then send.

        `latest`: s, until when a reply may come at least, beside the slack; in a chain the last reply.
        Raises PortError; OutputQueueFull if more than the last packet waits in the port (TX_BACKLOG), or if
        it does not accept all of this one. Then the goals are dropped, since they would be stale; an urgent
        packet (torque off) is sent later.
        """
        try:
            self._send(exchange, now, goals=goals, latest=latest)
        except PortError as error:
            self.exchange = None
            if error.kind is PortErrorCause.OUTPUT_FULL:
                self.urgent = self.urgent or self._leaving
                self._busy = -inf
            raise

    def _send(self, exchange: SerialTransaction, now: float, *, goals: bool, latest: float) -> None:
        self.strays = self.transport.drain(self._late)
        if self.strays:
            self._look_back(now)
        self._sensor_read = False
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
        first = lead + exchange.packet
        self._out = [first]
        self._sent_after = 0
        self._passed = 0
        self._echoes = self.echo
        if self.echo:
            self._echoed.clear()
        if lead and not self.one_write:
            self.transport.write(lead)
            self.transport.write(exchange.packet)
        else:
            self.transport.write(first)
        if self.urgent:
            self._leaving = self.urgent
            self.urgent = b""
        begin = max(now, self._busy)
        self._busy = begin + wire(len(first), self.baud)
        self.received = now
        # Wire time + return delays + slack: earlier, replies would be lost; later, the tick would overrun.
        span = self._step(exchange, 0) if exchange.then else self.span(exchange)
        self.deadline = begin + wire(len(lead), self.baud) + span
        if not self._done:
            self._latest = latest
            self.deadline += self.slack
            if not exchange.then:
                self.deadline = max(self.deadline, latest)

    def settle(self, ids: Sequence[int]) -> None:
        """Wait for bytes in the kernel where a missed reply of one of `ids` may be among them.

        They are drained before the next request. Else such a reply could pass for that of another register
        of the same size.
        """
        if not self._sensors.issuperset(ids) and not self.late_replies.ids.isdisjoint(ids):
            self.transport.settle()

    def feed(self, now: float) -> bool:
        """Process received bytes; return True when the transaction is complete. Raises PortError."""
        exchange = self.exchange
        if exchange is None or self._done or exchange.reply is None:
            return True
        reply = exchange.reply
        if self.echo and not self._past_echo(reply):
            return self._done
        count = self.transport.read_into(reply.receive_buffer())
        if count:
            self.received = now
            self._done = reply.take(count)
        if not self._done:
            self._go_on(exchange, reply, now)
        return self._done

    def _go_on(self, exchange: SerialTransaction, reply: PendingReply, now: float) -> None:
        """Send the next request of a chain once the reply to the last one is in, or late."""
        after = self._sent_after
        if after == len(exchange.then):
            return
        missing = sum(not reply.answered[place] for place in exchange.then[after][0])
        if missing > 0 and (now < self.deadline or self._passed + missing > PATIENCE):
            return
        self._passed += missing
        self._sent_after = after + 1
        self._out.append(exchange.then[after][1])
        self._echoed.clear()
        self.transport.write(exchange.then[after][1])
        self.deadline = now + self._step(exchange, after + 1) + self.slack
        if after + 1 == len(exchange.then):
            self.deadline = max(self.deadline, self._latest)

    def _step(self, exchange: SerialTransaction, place: int) -> float:
        """Return the bus time (s) of one request of a chain and its replies."""
        counts = [len(asked) for asked, _ in exchange.then]
        count = [*counts, exchange.delays - sum(counts)][place]
        requests = (exchange.packet, *(each for _, each in exchange.then))
        size = len(requests[place]) + count * (exchange.size - sum(map(len, requests))) // exchange.delays
        return wire(size, self.baud) + count * self.return_delay_s + exchange.extra / len(exchange.then)

    def end(self) -> SerialTransaction | None:
        """End the transaction; its result stays in the exchange's reply until the next one."""
        exchange = self.exchange
        self.exchange = None
        reply = exchange.reply if exchange is not None else None
        if reply is not None:
            self._sensor_read = self._sensors.issuperset(reply.ids)
            reply.end()
            self.strays += reply.strays
            if self._leaving and reply.answered.any():
                self._leaving = b""
            if reply.unasked:
                self._judge(reply.unasked, reply.first, self.received)
            if self.late_replies or not reply.whole:
                self.late_replies.record(reply, self.sent)
        return exchange

    # --------------------------------------------------------------------------- the rare cases

    def _require_room(self) -> None:
        waiting = self.transport.backlog()
        most = len(self._out[-1])
        if waiting > most:
            self.transport.flush()
            raise output_full(self.name, waiting, most)

    def _look_back(self, now: float) -> None:
        """Classify bytes that came after the last transaction had ended."""
        self._judge(self._find_packets(self._late, status=None), bytes(self._late), now)
        self._late.clear()
        if self._sensor_read:
            self.strays = 0

    def _judge(self, packets: Sequence[LinePacket], first: bytes, now: float) -> None:
        """Classify packets outside a reply, received at the latest at `now` (s).

        `first`: first bytes of the window; sent ones there are echo.
        """
        sent = self._out[0]
        own = list(self._find_packets(sent, status=False))
        returned = first.startswith(sent) or (len(first) > ECHO_START and sent.startswith(first))
        if own and returned and list(packets[: len(own)]) == own:
            self.echo = True
            packets = self._without_echo(packets)
        elif self._echoes:  # damaged in part
            packets = self._without_echo(packets)
        unrequested = [each for each in packets if each.is_status and each.id in self._sensors]
        self.late += [len(each.data) for each in unrequested]
        self.strays -= sum(each.octets for each in unrequested)
        self.late_replies.measure(packets, now)
        known = self.late_replies.ids | self._sensors
        self.foreign += sum(not each.is_status or each.id not in known for each in packets)

    def _without_echo(self, packets: Sequence[LinePacket]) -> list[LinePacket]:
        """Return the packets but for one of each that this transaction has sent; those are no strays."""
        sent = list(self._find_packets(b"".join(self._out), status=False))
        others = []
        for each in packets:
            if each in sent:
                sent.remove(each)
                self.strays -= each.octets
            else:
                others.append(each)
        return others

    def _past_echo(self, reply: PendingReply) -> bool:
        """Remove the echo from the front; return True once it is complete.

        Bytes that differ from the sent ones belong to the reply: the adapter's echo has ended.
        """
        sent = self._out[-1]
        left = len(sent) - len(self._echoed)
        if left:
            part = bytearray(left)
            count = self.transport.read_into(memoryview(part))
            self._echoed += part[:count]
            if not sent.startswith(self._echoed):
                self.echo = False
                buffer = reply.receive_buffer()
                count = min(len(buffer), len(self._echoed))  # of a babbling line it may be full
                buffer[:count] = self._echoed[:count]
                self._done = reply.take(count)
                return False
            return count == left
        return True
