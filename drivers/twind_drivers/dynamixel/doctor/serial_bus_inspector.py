"""Access of the doctor to a free bus of serial servos. Reads only: nothing here writes to a device."""

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
from twind_drivers.dynamixel import packet
from twind_drivers.dynamixel.dynamixel_tools import LONGEST_DELAY, PROTOCOL
from twind_drivers.dynamixel.replies import StatusReply
from twind_drivers.dynamixel.servo_type import ServoType
from twind_drivers.half_duplex.half_duplex_transactor import HalfDuplexTransactor, SerialTransaction
from twind_drivers.ports.serial_port import SerialTransport
from twind_drivers.servo_tools.prober import PortProber

REPLY_SLACK = 0.02  # s that a reply may take beside its wire time: a busy machine is no fault of a servo
PINGS = 12
SLOWEST = 0.03  # s: longer than any timer that adapters have as delivered
PING_REPLY = 14  # bytes


class ProbeReply(NamedTuple):
    """Reply of one servo to one ping or read."""

    data: bytes | None  # None: no reply, or an error alone
    delay: float  # s from the request to the last byte, without wire time
    strays: int  # bytes that were no part of the reply


class BusProbe:
    """One open serial port at its present baud rate. Every method may raise PortError."""

    def __init__(self, transport: ByteTransport, clock: Clock, baud: int, *, timer: float = 0.0) -> None:
        """`timer` (s): the adapter's latency timer, by which every reply may be late."""
        self._transport = transport
        self._clock = clock
        self._line = HalfDuplexTransactor(
            transport.name,
            transport,
            baud=baud,
            return_delay_s=LONGEST_DELAY,
            slack=REPLY_SLACK + timer,
            find_packets=packet.find_packets,
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
        data = reply.data[0].tobytes() if bool(reply.heard[0]) else None
        return ProbeReply(data, took - wire, self._line.strays)


class SerialBusInspector:
    """One free serial port at the rate of its bus. `transport`, `prober` may raise OperationFailed."""

    def __init__(self, port: str, baud: int, host: HostInspector, clock: Clock) -> None:
        """The port is opened when first used, and stays open until `close`."""
        self.port = port
        self.baud = baud
        self.host = host
        self.clock = clock
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
        return PortProber(self.transport, self.clock, self.baud, PROTOCOL, timer=self.timer_s)

    def ping_delays(self, ids: Sequence[int]) -> list[float]:
        """Return the delays (s, without wire time) of pings to the first device that answers.

        Raises OperationFailed.
        """
        delays: list[float] = []
        try:
            probe = BusProbe(self.transport, self.clock, self.baud, timer=SLOWEST)
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
        return (len(packet.ping(1)) + PING_REPLY) * 10 / self.baud, LONGEST_DELAY

    def open_probe(self) -> BusProbe:
        """Return a probe on the open port. Raises OperationFailed."""
        return BusProbe(self.transport, self.clock, self.baud, timer=self.timer_s)

    def close(self) -> None:
        """Close the port, if it was opened."""
        if self._open is not None:
            self._open.close()
            self._open = None
        self.__dict__.pop("transport", None)
        self.__dict__.pop("prober", None)


def inspector(request: InspectorRequest) -> SerialBusInspector:
    """Return the inspector of one free bus."""
    return SerialBusInspector(request.port, request.bus.baud, request.host, request.clock)


def reading_time(bus: BusSpec, joints: Sequence[JointSpec]) -> float:
    """Return the wire time (s) of one plain reading of a bus, goals and return delays included."""
    count = len(joints)
    data = (14 + 5 * count) + (14 + count) + count * (11 + 10)
    delays = [joint.type.return_delay_us for joint in joints if isinstance(joint.type, ServoType)]
    return data * 10 / bus.baud + sum(delays) * 1e-6
