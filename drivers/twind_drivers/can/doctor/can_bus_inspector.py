"""Access of the doctor to a free CAN bus. Reads only: nothing here writes to a device.

CAN questions are frames too. A daemon that receives frames that it did not send reports another master.
"""

from functools import cached_property

from twind.client import NoDaemon
from twind.config.robot_spec import BusSpec, RobotFile
from twind.doctor.family_doctor import InspectorRequest
from twind.doctor.host_inspector import HostInspector
from twind.exceptions import OperationFailed
from twind_drivers.bus import PortError
from twind_drivers.can.actuator import CanActuatorIdentity
from twind_drivers.can.can_reader import CanReader
from twind_drivers.can.can_type import CanType
from twind_drivers.clock import Clock
from twind_drivers.ports.can_ports import open_channel, parse
from twind_drivers.ports.channel import CanChannel


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


def inspector(request: InspectorRequest) -> CanBusInspector:
    """Return the inspector of one free bus."""
    return CanBusInspector(
        request.port, request.bus, request.robot, request.host, request.clock, request.no_daemon
    )
