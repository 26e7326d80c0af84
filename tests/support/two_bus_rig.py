"""Six virtual servos on two buses under a fake clock: the ports and the arithmetic of a robot, without robot.

Joints alternate between the buses, signs and gear ratios differ, so that a mixed-up index shows.
"""

import numpy as np

from twind.loop.bus.bus_port import BusPort, PortState
from twind.loop.bus.hardware import Hardware
from twind.robot.arrays import Floats
from twind.robot.joint_map import JointBusMap, JointMap
from twind.robot.joint_state import JointState
from twind_drivers.bus import BusReader, PortError
from twind_drivers.bus_writer import BusWriter
from twind_drivers.clock import FakeClock
from twind_drivers.dynamixel.dynamixel_reader import DynamixelReader
from twind_drivers.dynamixel.dynamixel_writer import DynamixelWriter
from twind_drivers.virtual.serial_loopback import Loopback
from twind_drivers.virtual.servo_physics import FirstOrderPhysics
from twind_drivers.virtual.virtual_serial_bus import VirtualBus
from twind_drivers.virtual.virtual_servos import ServoSpec

PERIOD = 0.01
BAUD = 1_000_000
BAUD_CODE = 3
# ticks that may ever be sent
LOWER = 1000
UPPER = 3000
IDS = {"left": (1, 2, 3), "right": (4, 5, 6)}
FASTEST = 46.0 / 60.0 * 4096  # ticks/s: no-load speed at 12 V
TURN = 2.0 * np.pi / 4096.0  # rad per tick without gear


def bus_map(name: str, places: list[int], zero: list[int], scale: list[float]) -> JointBusMap:
    factors = np.array(scale) * TURN
    return JointBusMap(
        name=name,
        joints=np.array(places),
        ids=IDS[name],
        zero=np.array(zero),
        scale=factors,
        velocity_scale=np.sign(factors) * 0.0239,
        effort_scale=np.sign(factors) * 0.001,
        lower=np.full(len(places), LOWER),
        upper=np.full(len(places), UPPER),
        fastest=np.full(len(places), FASTEST),
    )


JOINTS = JointMap(
    names=("a", "b", "c", "d", "e", "f"),
    buses=(
        bus_map("left", [0, 2, 4], [2048, 2060, 2100], [1.0, -1.0, 0.5]),
        bus_map("right", [1, 3, 5], [2048, 1990, 2048], [-0.5, 1.0, -1.0]),
    ),
    calibrated=(True,) * 6,
)


class TwoBuses:
    """The hardware, and the virtual servos behind it."""

    def __init__(self, *, live: bool = True) -> None:
        self.clock = FakeClock(50.0)
        self.virtual = {bus.name: self._servos(bus) for bus in JOINTS.buses}
        self.tries: list[tuple[str, float]] = []  # when each bus was tried to open
        self.ports = [
            BusPort(bus.name, f"virtual:{bus.name}", self.open, self.enable) for bus in JOINTS.buses
        ]
        self.hardware = Hardware(JOINTS, self.ports, self.clock, PERIOD)
        self.hardware.access(read=True, write=live)

    def _servos(self, bus: JointBusMap) -> VirtualBus:
        settings = {"return_delay_time": 0, "baud_rate": BAUD_CODE}
        specs = [ServoSpec(id, "XM430-W350", settings) for id in bus.ids]
        muscles = FirstOrderPhysics(bus.zero.astype(np.float64), now=self.clock.now())
        return VirtualBus(bus.name, specs, muscles, baud=BAUD, now=self.clock.now())

    def open(self, name: str) -> BusReader:
        self.tries.append((name, self.clock.now()))
        if not self.virtual[name].is_plugged:
            raise PortError(f"virtual:{name}", "no such port")
        transport = Loopback(self.virtual[name], self.clock)
        return DynamixelReader(name, transport, IDS[name], [1020] * 3, baud=BAUD, return_delay_us=0)

    @staticmethod
    def enable(reader: BusReader) -> BusWriter:
        assert isinstance(reader, DynamixelReader)
        return DynamixelWriter(reader, lower=np.full(3, LOWER), upper=np.full(3, UPPER))

    def tick(self, goal: Floats | None = None, count: int = 1) -> JointState:
        """Let `count` ticks pass; the last reading."""
        assert count > 0
        for _ in range(count):
            now = self.clock.now()
            state = self.hardware.exchange(goal, now)
            assert self.clock.now() - now <= PERIOD, "the exchange lasts longer than a tick"
            self.clock.sleep_until(now + PERIOD)
        return state

    def connect(self) -> None:
        """Open, and everybody read once, identification over."""
        self.tick(count=60)
        assert all(port.identification is not None and port.identification.done for port in self.ports)
        for port in self.ports:
            port.identification = None
            port.link = PortState.CONNECTED
            port.prepared = True
        self.hardware.hold(True)

    def goals(self) -> list[int]:
        """The goal registers in joint order."""
        found = np.zeros(len(JOINTS), np.int64)
        for bus in JOINTS.buses:
            found[bus.joints] = self.virtual[bus.name].servos["goal_position"]
        return [int(value) for value in found]
