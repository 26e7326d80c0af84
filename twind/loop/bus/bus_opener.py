"""Opener of the buses of a robot file: readers, and the writers of these readers.

Only this module relates a kind of bus to its driver.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from twind.config.actuator_types import CAN, CanType, ServoType
from twind.config.robot_file import RobotFile
from twind.config.robot_spec import JointSpec
from twind.loop.bus.bus_tap import RecordingBusTap, TappedChannel, TappedTransport
from twind.robot.joint_map import JointBusMap, JointMap
from twind_drivers.bus import BusReader, BusWriter
from twind_drivers.byte_transport import ByteTransport
from twind_drivers.can.can_bus import CanActuatorIdentity, CanReader, CanWriter
from twind_drivers.ports.can_ports import open_channel, present
from twind_drivers.ports.channel import CanChannel
from twind_drivers.dynamixel.control_tables import number_of
from twind_drivers.dynamixel.dynamixel_bus import DynamixelReader, DynamixelWriter, RawGains
from twind_drivers.ports.serial_port import SerialTransport


@dataclass(frozen=True)
class BusOpener:
    """Opener of each bus of a robot: makes the driver's reader and writer from the robot file."""

    robot: RobotFile
    joints: JointMap
    ports: Mapping[str, str | None]
    rate_hz: float
    tapes: Mapping[str, RecordingBusTap] = field(default_factory=dict)  # buses that are written down

    def open(self, name: str) -> BusReader:
        """Open a bus on its port and return the reader. Raises PortError."""
        port = self.ports[name]
        assert port is not None
        bus = self.robot.bus(name)
        if bus.kind == CAN:
            return self.can_reader(name, open_channel(port, bus.baud))
        return self.reader(name, SerialTransport(port, bus.baud))

    def reader(self, name: str, transport: ByteTransport) -> BusReader:
        """Return the reader of a serial bus on any transport."""
        kinds = [kind for _, kind in self._servos(name)]
        tape = self.tapes.get(name)
        return DynamixelReader(
            name,
            transport if tape is None else TappedTransport(transport, tape),
            self._map(name).ids,
            [number_of(kind.device) for kind in kinds],
            baud=self.robot.bus(name).baud,
            return_delay_us=max(kind.return_delay_us for kind in kinds),
            rate_hz=self.rate_hz,
            one_write=self.robot.bus(name).one_write,
            sensors=self._sensors(name),
        )

    def _sensors(self, name: str) -> dict[int, float]:
        """Return the reply delay (s) by id of the devices on a bus besides its servos."""
        imu = self.robot.imu
        return {} if imu is None or imu.bus != name else {imu.id: imu.return_delay_us * 1e-6}

    def can_reader(self, name: str, channel: CanChannel) -> BusReader:
        """Return the reader of a CAN bus on any channel."""
        actuators = [
            CanActuatorIdentity(
                id=joint.id,
                feedback_id=joint.id if joint.feedback_id is None else joint.feedback_id,
                model=kind.device,
                position=kind.ranges.position_rad,
                velocity=kind.ranges.velocity_rad_s,
                torque=kind.ranges.torque_nm,
            )
            for joint, kind in self._actuators(name)
        ]
        tape = self.tapes.get(name)
        channel = channel if tape is None else TappedChannel(channel, tape)
        return CanReader(name, channel, actuators, bitrate=self.robot.bus(name).baud, rate_hz=self.rate_hz)

    def enable(self, reader: BusReader) -> BusWriter:
        """Return the writer of a bus; its clamp (WIRE_CLAMP) is the joints' hard range in ticks."""
        if isinstance(reader, CanReader):
            return self._enable_can(reader)
        assert isinstance(reader, DynamixelReader)
        bus = self._map(reader.name)
        joints = self._servos(reader.name)
        return DynamixelWriter(
            reader,
            lower=bus.lower,
            upper=bus.upper,
            gains=[RawGains(kind.gains.p, kind.gains.i, kind.gains.d) for _, kind in joints],
            modes=[joint.operating_mode for joint, _ in joints],
            current_caps=[joint.current_cap for joint, _ in joints],
        )

    def _enable_can(self, reader: CanReader) -> BusWriter:
        bus = self._map(reader.name)
        kinds = [kind for _, kind in self._actuators(reader.name)]
        return CanWriter(
            reader,
            lower=bus.lower,
            upper=bus.upper,
            kp=np.array([kind.gains.kp for kind in kinds]),
            kd=np.array([kind.gains.kd for kind in kinds]),
            torque_limits=np.array([kind.torque_limit_nm for kind in kinds]),
            watchdog=[kind.watchdog == "device" for kind in kinds],
        )

    def refuse_taken(self) -> None:
        """Open and close every port once, so that a port that cannot be opened is refused at start.

        A port that does not exist yet is no failure: the robot may be plugged in later. Raises PortError.
        """
        held: list[CanChannel | SerialTransport] = []  # all at once: two buses on one port are refused too
        try:
            for name, port in self.ports.items():
                if port is not None:
                    held.extend(
                        self._open_present(self.robot.bus(name).kind, port, self.robot.bus(name).baud)
                    )
        finally:
            for each in held:
                each.close()

    @staticmethod
    def _open_present(kind: str, port: str, rate: int) -> list[CanChannel | SerialTransport]:
        if kind == CAN:
            return [open_channel(port, rate)] if present(port) else []
        return [SerialTransport(port, rate)] if Path(port).exists() else []

    def _map(self, name: str) -> JointBusMap:
        return next(bus for bus in self.joints.buses if bus.name == name)

    def _joints(self, name: str) -> list[JointSpec]:
        return [self.robot.joints[int(place)] for place in self._map(name).joints]

    def _servos(self, name: str) -> list[tuple[JointSpec, ServoType]]:
        return [(each, each.type) for each in self._joints(name) if isinstance(each.type, ServoType)]

    def _actuators(self, name: str) -> list[tuple[JointSpec, CanType]]:
        return [(each, each.type) for each in self._joints(name) if isinstance(each.type, CanType)]
