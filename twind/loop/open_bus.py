"""Opens the serial buses of a robot file as readers, and makes their writers: the loop's way to a driver."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from twind.config.robot_file import RobotFile
from twind.config.robot_spec import JointSpec
from twind.robot.joints import BusMap, JointMap
from twind_drivers.bus import Reader, Transport, Writer
from twind_drivers.dynamixel.bus import DynamixelReader, DynamixelWriter, Gains
from twind_drivers.dynamixel.serial_port import SerialTransport
from twind_drivers.dynamixel.tables import number_of


@dataclass(frozen=True)
class Buses:
    """How each bus of a robot is opened."""

    robot: RobotFile
    joints: JointMap
    ports: Mapping[str, str | None]
    rate_hz: float

    def open(self, name: str) -> Reader:
        """The read half of a bus, on its serial port. Raises PortError."""
        port = self.ports[name]
        assert port is not None
        return self.reader(name, SerialTransport(port, self.robot.bus(name).baud))

    def reader(self, name: str, transport: Transport) -> Reader:
        """The read half of a bus, on any transport."""
        joints = self._joints(name)
        return DynamixelReader(
            name,
            transport,
            self._map(name).ids,
            [number_of(joint.type.device) for joint in joints],
            baud=self.robot.bus(name).baud,
            return_delay_us=max(joint.type.return_delay_us for joint in joints),
            rate_hz=self.rate_hz,
            one_write=self.robot.bus(name).one_write,
        )

    def enable(self, reader: Reader) -> Writer:
        """The write half of a bus: its clamp (R22) is the joints' hard range in ticks."""
        assert isinstance(reader, DynamixelReader)
        bus, joints = self._map(reader.name), self._joints(reader.name)
        gains = [Gains(joint.type.gains.p, joint.type.gains.i, joint.type.gains.d) for joint in joints]
        return DynamixelWriter(
            reader,
            lower=bus.lower,
            upper=bus.upper,
            gains=gains,
            modes=[joint.operating_mode for joint in joints],
            current_caps=[joint.current_cap for joint in joints],
        )

    def refuse_taken(self) -> None:
        """Open and close every port once: one that cannot be had is refused now, with the reason.

        A port that does not exist yet is no failure: the robot may be plugged in later. Raises PortError.
        """
        for name, port in self.ports.items():
            if port is not None and Path(port).exists():
                SerialTransport(port, self.robot.bus(name).baud).close()

    def _map(self, name: str) -> BusMap:
        return next(bus for bus in self.joints.buses if bus.name == name)

    def _joints(self, name: str) -> list[JointSpec]:
        return [self.robot.joints[int(place)] for place in self._map(name).joints]
