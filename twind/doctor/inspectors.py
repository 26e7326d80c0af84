"""Access of the doctor to a running daemon and to free buses. Reads only: nothing here writes to a device.

CAN questions are frames too. A daemon that receives frames that it did not send reports another master.
"""

import socket
import struct
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

from twind.client import CallError, Client, ClientError, NoDaemon
from twind.config.robot_spec import BusSpec, RobotFile
from twind.doctor.host_inspector import HostInspector
from twind.exceptions import OperationFailed
from twind.protocol.messages import JointMessage, StatusMessage
from twind_drivers.bus import PortError
from twind_drivers.byte_transport import ByteTransport
from twind_drivers.can.actuator import CanActuatorIdentity
from twind_drivers.can.can_reader import CanReader
from twind_drivers.can.can_type import CanType
from twind_drivers.clock import Clock
from twind_drivers.dynamixel import packet
from twind_drivers.dynamixel.prober import LONGEST_DELAY, PortProber
from twind_drivers.dynamixel.replies import StatusReply
from twind_drivers.half_duplex.half_duplex_transactor import HalfDuplexTransactor, SerialTransaction
from twind_drivers.ports.can_ports import open_channel, parse
from twind_drivers.ports.channel import CanChannel
from twind_drivers.ports.serial_port import SerialTransport

PATIENCE = 2.0  # s for one reply: a daemon in trouble must not block its diagnosis
SCAN_PATIENCE = 65.0  # s for one reply of an operator's connection: a scan of a slow bus
REPLY_SLACK = 0.02  # s that a reply may take beside its wire time: a busy machine is no fault of a servo
PEER = struct.Struct("3i")  # struct ucred: pid, uid, gid (unix(7))
Answer = dict[str, Any]


class DaemonInspector:
    """One daemon on one connection. Each property asks once; it may raise OperationFailed."""

    def __init__(self, client: Client) -> None:
        """`client`: connected to the observe or the control socket."""
        self.client = client
        self.path = client.path
        self._silent = ""  # reason why it is asked no more: one timeout is enough

    @cached_property
    def status(self) -> StatusMessage:
        """`Status` of the interface."""
        status: StatusMessage = self._both["status"]
        return status

    @cached_property
    def joints(self) -> list[JointMessage]:
        """`[]Joint` of the interface, in the order of the robot file."""
        joints: list[JointMessage] = self._both["joints"]
        return joints

    @cached_property
    def parameters(self) -> Answer:
        """Settings in force: mode, robot, individual, source (the file they came from), …"""
        parameters: Answer = self.ask("GetParameters")["parameters"]
        return parameters

    @cached_property
    def robot(self) -> Answer:
        """`robot` (the file as checked: path, text_sha256, joints, …), `calibration` or None, `mjcf`."""
        return self.ask("GetRobot")

    @cached_property
    def latency(self) -> dict[str, Answer]:
        """`Latency` of the interface by hop: request, reply, state, twin, …"""
        if self._silent:
            raise OperationFailed(self._silent)
        try:
            for news in self.client.stream("Monitor", topics=["latency"], rate=10.0):
                return {str(hop["hop"]): hop for hop in news.get("latency") or ()}
        except ClientError as error:
            raise OperationFailed(f"the daemon does not answer Monitor: {error}") from error
        raise OperationFailed("the daemon ended Monitor without an answer")

    @property
    def is_live(self) -> bool:
        """True if it may write to the bus."""
        return bool(self.status["mode"] == "live")

    @cached_property
    def listener(self) -> int:
        """Pid of the listener: the daemon, or the service manager that passed the socket on."""
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
            try:
                probe.settimeout(PATIENCE)
                probe.connect(self.path)
            except OSError as error:
                raise OperationFailed(f"{self.path}: {error.strerror or error}") from error
            found = probe.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, PEER.size)
        return int(PEER.unpack(found)[0])

    def ask(self, method: str, **parameters: Any) -> Answer:
        """Call a reading method. Raises OperationFailed with the daemon's reply."""
        if self._silent:
            raise OperationFailed(self._silent)
        try:
            return self.client.call(method, **parameters)
        except CallError as error:
            raise OperationFailed(f"{method}: {error}") from error
        except ClientError as error:
            self._silent = f"the daemon does not answer {method}: {error}"
            raise OperationFailed(self._silent) from error

    def open_operator(self) -> Client:
        """Open a connection that may read registers. Raises OperationFailed: this user is no operator."""
        client = Client(Path(self.path).parent, timeout=SCAN_PATIENCE)
        try:
            client.connect()
        except ClientError as error:
            raise OperationFailed(f"registers are read by operators alone: {error}") from error
        return client

    def port_of(self, bus: str) -> str:
        """Return the port of a bus. Raises OperationFailed."""
        for each in self.status["buses"]:
            if each["name"] == bus:
                return str(each["port"])
        raise OperationFailed(f"the daemon has no bus {bus}: it runs with another robot file")

    @cached_property
    def _both(self) -> Answer:
        return self.ask("GetStatus", joints=True)


def scan_bus(client: Client, bus: str) -> dict[int, Answer]:
    """Scan a bus through the daemon: the devices that answer among those of its robot file, by id.

    Empty where all are silent. Raises OperationFailed: the bus failed, or the daemon does not answer.
    """
    try:
        return {int(found["id"]): dict(found) for found in client.stream("Scan", bus=bus)}
    except CallError as error:
        if error.name == "BusFailed" and error.parameters.get("silent"):
            return {}
        raise OperationFailed(f"bus {bus}: {error}") from error
    except ClientError as error:
        raise OperationFailed(f"the daemon does not answer Scan: {error}") from error


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
        return PortProber(self.transport, self.clock, self.baud, timer=self.timer_s)

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


class CanBusInspector:
    """One free CAN bus at its bit rate. `channel`, `reader` may raise OperationFailed."""

    def __init__(
        self,
        port: str,
        spec: BusSpec,
        robot: RobotFile,
        host: HostInspector,
        clock: Clock,
        why: NoDaemon | None,
    ) -> None:
        """The channel is opened when first used, and stays open until `close`.

        `why`: the reason that no daemon was reached.
        """
        self.port = port
        self.spec = spec
        self.robot = robot
        self.host = host
        self.clock = clock
        self._why = why
        self._open: CanChannel | None = None

    @cached_property
    def channel(self) -> CanChannel:
        """The open channel. Raises OperationFailed: possibly driven, held, missing, not permitted, down."""
        self._require_alone()
        try:
            self._open = open_channel(self.port, self.spec.baud)
        except PortError as error:
            raise OperationFailed(str(error)) from error
        return self._open

    @cached_property
    def reader(self) -> CanReader:
        """Reader of the actuators that the robot file names; it cannot command."""
        actuators = [
            CanActuatorIdentity(
                id=joint.id,
                feedback_id=joint.id if joint.feedback_id is None else joint.feedback_id,
                model=joint.type.device,
                position=joint.type.ranges.position_rad,
                velocity=joint.type.ranges.velocity_rad_s,
                torque=joint.type.ranges.torque_nm,
            )
            for joint in self.robot.joints
            if joint.bus == self.spec.name and isinstance(joint.type, CanType)
        ]
        return CanReader(self.spec.name, self.channel, actuators, bitrate=self.spec.baud)

    def _require_alone(self) -> None:
        """Raise OperationFailed where another program may drive the bus: most adapters can be shared."""
        parts = parse(self.port)
        if parts.interface == "slcan":  # a serial port: its driver has it open
            for other in self.host.holders(parts.channel):
                raise OperationFailed(f"{parts.channel} is held by pid {other.pid} ({other.command})")
            return
        shut = f"{self.port} was not opened"
        if self._why is not None and not self._why.absent:
            raise OperationFailed(f"{shut}, a daemon may drive it: {self._why}")
        for other in self.host.daemons():
            how = "ask that one with `--socket DIR`, or stop it"
            raise OperationFailed(f"{shut}, pid {other.pid} ({other.command}) may drive it: {how}")
        if parts.interface == "socketcan" and self.host.hears(parts.channel):
            raise OperationFailed(f"{shut}, a program listens there (/proc/net/can): end it, then look again")

    def close(self) -> None:
        """Close the channel, if it was opened."""
        if self._open is not None:
            self._open.close()
            self._open = None
        self.__dict__.pop("channel", None)
        self.__dict__.pop("reader", None)
