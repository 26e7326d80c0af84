"""Our CAN driver on virtual nodes, in process under a fake clock: both sides speak real frames."""

from collections.abc import Sequence

import numpy as np

from tests.support.can_loopback import CanLoopback
from tests.support.driver_rig import DriverRig
from twind_drivers.bus import IdentifiedDevice
from twind_drivers.can.actuator import CanActuatorIdentity
from twind_drivers.can.can_models import model
from twind_drivers.can.can_reader import CanReader
from twind_drivers.can.can_units import COUNT, TURN
from twind_drivers.can.can_writer import CanWriter
from twind_drivers.clock import FakeClock
from twind_drivers.ports.frame import Frames
from twind_drivers.virtual.can.can_controller import CanAdapter
from twind_drivers.virtual.can.can_motor_physics import FirstOrderCanPhysics
from twind_drivers.virtual.can.node_spec import NodeSpec
from twind_drivers.virtual.can.virtual_can_bus import VirtualCanBus

BITRATE = 1_000_000
EDGE = TURN // 2 - 200  # counts: goals that may be sent, either way
RANGES = {"ODrive": (12.5, 30.0, 10.0)}  # of models that no source gives ranges of


def actuators(models: Sequence[str]) -> list[CanActuatorIdentity]:
    made = []
    for id, name in enumerate(models, start=1):
        known = model(name)
        position, velocity, torque = RANGES.get(name, (known.position, known.velocity, known.torque))
        made.append(
            CanActuatorIdentity(
                id, id + 0x10 if known.family == "damiao" else id, name, position, velocity, torque
            )
        )
    return made


class Tapped(CanLoopback):
    """Keeps what was sent."""

    def __init__(self, bus: VirtualCanBus, clock: FakeClock) -> None:
        super().__init__(bus, clock)
        self.trains: list[Frames] = []

    def send(self, frames: Frames, now: float) -> None:
        super().send(frames, now)
        self.trains.append(frames.copy())


class CanRig(DriverRig):
    """Actuators at 0.25 rad, limp."""

    def __init__(
        self,
        models: Sequence[str] = ("DM4310",) * 4,
        *,
        adapter: CanAdapter | None = None,
        watchdog: bool | None = None,
        settings: dict[str, float] | None = None,
        rate_hz: float = 100.0,
    ) -> None:
        """`watchdog`: every actuator must have one; None: of those who can."""
        self.name = "can"
        self.actuators = actuators(models)
        nodes = [
            NodeSpec(
                each.id,
                each.model,
                feedback_id=each.feedback_id,
                position=each.position,
                velocity=each.velocity,
                torque=each.torque,
                settings=settings or {},
            )
            for each in self.actuators
        ]
        self.rate_hz = rate_hz
        self.clock = FakeClock()
        self.muscles = FirstOrderCanPhysics(np.full(len(nodes), 0.25))
        self.bus = VirtualCanBus("arm", nodes, self.muscles, bitrate=BITRATE, adapter=adapter)
        self.faults = self.bus.faults
        families = [model(each.model).family for each in self.actuators]
        self.watchdog = [
            family in ("damiao", "robstride") if watchdog is None else watchdog for family in families
        ]
        self.first = 1.1 if "cubemars" in families else 0.0
        self.lower = np.full(len(nodes), -EDGE)
        self.upper = np.full(len(nodes), EDGE)
        self.open()

    def open(self) -> None:
        """The port anew: a channel, a reader, a writer."""
        m = len(self.actuators)
        self.channel = Tapped(self.bus, self.clock)
        self.reader: CanReader = CanReader(
            "arm", self.channel, self.actuators, bitrate=BITRATE, rate_hz=self.rate_hz
        )
        self.writer: CanWriter = CanWriter(
            self.reader,
            lower=self.lower,
            upper=self.upper,
            kp=np.full(m, 40.0),
            kd=np.full(m, 1.0),
            watchdog=self.watchdog,
        )

    def identify(self) -> tuple[IdentifiedDevice, ...]:
        found: tuple[IdentifiedDevice, ...] = self.perform(self.reader.identify())
        return found

    def places(self) -> np.ndarray:
        return np.rint(np.asarray(self.muscles.position) / COUNT).astype(np.int64)

    def energised(self) -> np.ndarray:
        return np.array([node.shaft.on for node in self.bus.nodes.each])

    def sent(self) -> int:
        return len(self.channel.trains)
