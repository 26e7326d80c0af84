"""A CAN bus looked at by its own channel, where no daemon holds it: no half that writes.

Questions are frames too, and a daemon that hears frames that it did not send takes them for another master's.
"""

from functools import cached_property

from twind.client import NoDaemon
from twind.config.actuator_types import CanType
from twind.config.robot_spec import BusSpec, RobotFile
from twind.doctor.check import CheckUnavailable
from twind.doctor.host_inspector import HostInspector
from twind_drivers.bus import PortError
from twind_drivers.can.actuator import CanActuator
from twind_drivers.can.can_ports import open_channel, parse
from twind_drivers.can.can_reader import CanReader
from twind_drivers.can.channel import CanChannel
from twind_drivers.clock import Clock


class CanBusInspector:
    """One CAN bus at its bit rate. `channel`, `reader` may raise CannotLook."""

    def __init__(
        self,
        port: str,
        spec: BusSpec,
        robot: RobotFile,
        host: HostInspector,
        clock: Clock,
        why: NoDaemon | None,
    ) -> None:
        """Opens nothing yet: the channel is opened when first used, and stays open until `close`.

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
        """The open channel. Raises CannotLook: a daemon may drive it, held, not there or permitted, down."""
        self._require_alone()
        try:
            self._open = open_channel(self.port, self.spec.baud)
        except PortError as error:
            raise CheckUnavailable(str(error)) from error
        return self._open

    @cached_property
    def reader(self) -> CanReader:
        """Asks the actuators that the robot file names; it cannot command."""
        actuators = [
            CanActuator(
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
        """Raises CannotLook where somebody may drive the bus: most adapters can be opened beside him."""
        parts = parse(self.port)
        if parts.interface == "slcan":  # a serial port: who has it, has it open
            for other in self.host.holders(parts.channel):
                raise CheckUnavailable(f"{parts.channel} is held by pid {other.pid} ({other.command})")
            return
        shut = f"{self.port} was not opened"
        if self._why is not None and not self._why.absent:
            raise CheckUnavailable(f"{shut}, a daemon may drive it: {self._why}")
        for other in self.host.daemons():
            how = "ask that one with `--socket DIR`, or stop it"
            raise CheckUnavailable(f"{shut}, pid {other.pid} ({other.command}) may drive it: {how}")
        if parts.interface == "socketcan" and self.host.hears(parts.channel):
            raise CheckUnavailable(
                f"{shut}, a program listens there (/proc/net/can): end it, then look again"
            )

    def close(self) -> None:
        """Let go of the channel, if it was opened."""
        if self._open is not None:
            self._open.close()
            self._open = None
        self.__dict__.pop("channel", None)
        self.__dict__.pop("reader", None)
