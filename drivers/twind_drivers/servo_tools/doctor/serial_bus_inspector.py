"""Access of the doctor to a free bus of serial servos. Only `open_writer`, for a fix, can write."""

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

from twind.config.robot_spec import BusSpec, JointSpec
from twind.doctor.family_doctor import InspectorRequest
from twind.doctor.host_inspector import HostInspector
from twind.exceptions import OperationFailed
from twind_drivers.bus import PortError
from twind_drivers.byte_transport import ByteTransport
from twind_drivers.clock import Clock
from twind_drivers.half_duplex.half_duplex_transactor import HalfDuplexTransactor, SerialTransaction
from twind_drivers.half_duplex.pending_reply import wire
from twind_drivers.ports.serial_port import SerialTransport
from twind_drivers.servo_tools.family_tools import FamilyTools, need_tools
from twind_drivers.servo_tools.prober import PortProber
from twind_drivers.servo_tools.scan_protocol import ServoIdentity
from twind_drivers.servo_tools.servo_configurator import WritableProber

REPLY_SLACK = 0.02  # s that a reply may take beside its wire time: a busy machine is no fault of a servo
PINGS = 12
SLOWEST = 0.03  # s: longer than any timer that adapters have as delivered


class ProbeReply(NamedTuple):
    """Reply of one servo to one ping or read."""

    data: bytes | None  # None: no reply, or an error alone
    delay: float  # s from the request to the last byte, without wire time
    strays: int  # bytes that were no part of the reply
    error: int  # its error byte


class BusProbe:
    """One open serial port at its present baud rate. Every method may raise PortError."""

    def __init__(
        self, transport: ByteTransport, clock: Clock, baud: int, tools: FamilyTools, *, timer: float = 0.0
    ) -> None:
        """`timer` (s): the adapter's latency timer, by which every reply may be late."""
        self._protocol = tools.protocol
        self._reply = tools.reply
        self._transport = transport
        self._clock = clock
        self._line = HalfDuplexTransactor(
            transport.name,
            transport,
            baud=baud,
            return_delay_s=tools.protocol.delay,
            slack=REPLY_SLACK + timer,
            find_packets=tools.protocol.find_packets,
        )

    def ping(self, id: int) -> ProbeReply:
        """Ping one servo."""
        return self._ask(id, self._protocol.ping(id), self._protocol.ping_size)

    def identify(self, id: int) -> ServoIdentity | None:
        """Return the identity of one servo; None: it does not answer, or is of another family."""
        address, size = self._protocol.identity
        data = (self.read(id, address, size) if size else self.ping(id)).data
        return None if data is None else self._protocol.identify(id, data)

    def read(self, id: int, address: int, size: int) -> ProbeReply:
        """Read `size` bytes from `address` of one servo."""
        return self._ask(id, self._protocol.read(id, address, size), size)

    def _ask(self, id: int, request: bytes, size: int) -> ProbeReply:
        reply = self._reply(id, size, request)
        exchange = SerialTransaction(request, reply, 1)
        self._line.send(exchange, self._clock.now())
        while not self._line.feed(self._clock.now()) and self._clock.now() < self._line.deadline:
            self._clock.wait([self._transport], self._line.deadline)
        took = self._clock.now() - self._line.sent
        self._line.end()
        wire = self._line.span(exchange) - self._protocol.delay
        data = reply.data[0].tobytes() if bool(reply.heard[0]) else None
        return ProbeReply(data, took - wire, self._line.strays, int(reply.error[0]))


class SerialBusInspector:
    """One free serial port at the rate of its bus. `transport`, `prober` may raise OperationFailed."""

    def __init__(self, port: str, baud: int, host: HostInspector, clock: Clock, tools: FamilyTools) -> None:
        """The port is opened when first used, and stays open until `close`."""
        self.port = port
        self.baud = baud
        self.host = host
        self.clock = clock
        self.tools = tools
        self._open: SerialTransport | None = None

    @cached_property
    def transport(self) -> SerialTransport:
        """The open port. Raises OperationFailed: held (with the holder), missing, not permitted."""
        for other in self.host.holders(self.port):  # also those without a lock: they would get our replies
            raise OperationFailed(f"{self.port} is held by pid {other.pid} ({other.command})")
        try:
            self._open = SerialTransport(self.port, self.baud)
        except PortError as error:
            raise OperationFailed(str(error)) from error
        return self._open

    @property
    def timer_s(self) -> float:
        """Latency timer (s) of the adapter; 0: unknown. Opens the port."""
        return (self.transport.latency_ms or 0) * 1e-3

    @cached_property
    def prober(self) -> PortProber:
        """One question at a time; it cannot write."""
        return PortProber(self.transport, self.clock, self.baud, self.tools.protocol, timer=self.timer_s)

    def ping_delays(self, ids: Sequence[int]) -> list[float]:
        """Return the delays (s, without wire time) of pings to the first device that answers.

        Raises OperationFailed.
        """
        delays: list[float] = []
        try:
            probe = BusProbe(self.transport, self.clock, self.baud, self.tools, timer=SLOWEST)
            for id in ids[:4]:
                for _ in range(PINGS):
                    reply = probe.ping(id)
                    if reply.data is None:
                        break
                    delays.append(reply.delay)
                if delays:
                    break
        except PortError as error:
            raise OperationFailed(str(error)) from error
        return delays

    @property
    def ping_time(self) -> tuple[float, float]:
        """Wire time of a ping with its reply (s), and the longest return delay that a servo can have."""
        protocol = self.tools.protocol
        return wire(len(protocol.ping(1)) + protocol.overhead + protocol.ping_size, self.baud), protocol.delay

    def open_probe(self) -> BusProbe:
        """Return a probe on the open port. Raises OperationFailed."""
        return BusProbe(self.transport, self.clock, self.baud, self.tools, timer=self.timer_s)

    def open_writer(self, baud: int) -> WritableProber:
        """Return a prober that can write, for a fix. Raises OperationFailed."""
        return WritableProber(self.transport, self.clock, baud, self.tools.protocol, timer=self.timer_s)

    def close(self) -> None:
        """Close the port, if it was opened."""
        if self._open is not None:
            self._open.close()
            self._open = None
        self.__dict__.pop("transport", None)
        self.__dict__.pop("prober", None)


def inspector(request: InspectorRequest) -> SerialBusInspector:
    """Return the inspector of one free bus."""
    tools = need_tools(request.bus.kind)
    return SerialBusInspector(request.port, request.bus.baud, request.host, request.clock, tools)


def reading_time(bus: BusSpec, joints: Sequence[JointSpec]) -> float:
    """Return the wire time (s) of one plain reading of a bus, goals and return delays included."""
    return need_tools(bus.kind).reading_time(bus, joints)
