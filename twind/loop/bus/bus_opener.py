"""Opener of the buses of a robot file: ports, readers by the driver family of each bus, and their writers."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from twind.config.driver_family import BusDriver, BusSetup, family
from twind.config.port_names import Medium
from twind.config.robot_file import RobotFile
from twind.loop.bus.bus_tap import RecordingBusTap, TappedChannel, TappedTransport
from twind.robot.joint_map import JointMap
from twind_drivers.bus import BusReader
from twind_drivers.bus_writer import BusWriter
from twind_drivers.byte_transport import ByteTransport
from twind_drivers.ports.can_ports import open_channel, present
from twind_drivers.ports.channel import CanChannel
from twind_drivers.ports.serial_port import SerialTransport


@dataclass(frozen=True)
class BusOpener:
    """Opener of each bus of a robot: makes the driver's reader and writer from the robot file."""

    robot: RobotFile
    joints: JointMap
    ports: Mapping[str, str | None]
    rate_hz: float
    tapes: Mapping[str, RecordingBusTap] = field(default_factory=dict)  # buses that are written down

    def __post_init__(self) -> None:
        for bus in self.robot.buses:  # an import in a tick would delay it
            self._driver(bus.name)

    def open(self, name: str) -> BusReader:
        """Open a bus on its port and return the reader. Raises PortError."""
        port = self.ports[name]
        assert port is not None
        rate = self.robot.bus(name).baud
        can = self._medium(name) is Medium.CAN
        open_port = open_channel if can else SerialTransport
        return self.reader(name, open_port(port, rate, by_signal=True))

    def reader(self, name: str, port: Any) -> BusReader:
        """Return the reader of a bus on any port of its medium (`ByteTransport` or `CanChannel`)."""
        return self._driver(name).reader(self._setup(name), self._tapped(name, port))

    def enable(self, reader: BusReader) -> BusWriter:
        """Return the writer of a bus; its clamp (WIRE_CLAMP) is the joints' hard range in ticks."""
        return self._driver(reader.name).writer(self._setup(reader.name), reader)

    def refuse_taken(self) -> None:
        """Open and close every port once, so that a port that cannot be opened is refused at start.

        A port that does not exist yet is no failure: the robot may be plugged in later. Raises PortError.
        """
        held: list[CanChannel | SerialTransport] = []  # all at once: two names of one port are refused too
        try:
            for name, port in self.ports.items():
                if port is not None:
                    held.extend(self._open_present(name, port))
        finally:
            for each in held:
                each.close()

    def _open_present(self, name: str, port: str) -> list[CanChannel | SerialTransport]:
        rate = self.robot.bus(name).baud
        if self._medium(name) is Medium.CAN:
            return [open_channel(port, rate)] if present(port) else []
        return [SerialTransport(port, rate)] if Path(port).exists() else []

    def _tapped(self, name: str, port: Any) -> ByteTransport | CanChannel:
        """Return the port, or one that records its bytes or frames too."""
        tape = self.tapes.get(name)
        tapped = TappedChannel if self._medium(name) is Medium.CAN else TappedTransport
        return port if tape is None else tapped(port, tape)

    def _driver(self, name: str) -> BusDriver:
        return family(self.robot.bus(name).kind).driver.load()

    def _medium(self, name: str) -> Medium:
        return family(self.robot.bus(name).kind).medium

    def _setup(self, name: str) -> BusSetup:
        bus = next(bus for bus in self.joints.buses if bus.name == name)
        imu = self.robot.imu
        return BusSetup(
            bus=self.robot.bus(name),
            ids=bus.ids,
            joints=tuple(self.robot.joints[int(place)] for place in bus.joints),
            lower=bus.lower,
            upper=bus.upper,
            rate_hz=self.rate_hz,
            sensors={} if imu is None or imu.bus != name else {imu.id: imu.return_delay_us * 1e-6},
        )
