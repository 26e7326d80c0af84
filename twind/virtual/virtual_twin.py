"""Virtual twin of a driver family: what `twind-virtual` asks of it to make its devices and serve its buses.

A family's record names its `VirtualTwin` (`DriverFamily.virtual`). A device description is of the family's
own class; the program reads `id`, `model` and `hinge` of it.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from twind.config.driver_family import DriverFamily
from twind.config.robot_spec import BusSpec, JointSpec
from twind.twin.mujoco_physics import MujocoPhysics
from twind.virtual.fault_commands import FaultArguments
from twind.virtual.robot_ground_truth import JointGroundTruth
from twind_drivers.bus import IdentifiedDevice
from twind_drivers.virtual.faulty_byte_stream import SerialAdapter
from twind_drivers.virtual.hinge import Hinge
from twind_drivers.virtual.servable_bus import ServableBus
from twind_drivers.virtual.virtual_sensor import VirtualSensor


@dataclass(frozen=True, slots=True)
class BusTiming:
    """Timing of the buses, independent of the devices on them."""

    wire_timing: bool = True
    adapter: SerialAdapter = field(default_factory=SerialAdapter)
    seed: int = 0  # of all that is random


@dataclass(frozen=True, slots=True)
class DeviceOptions:
    """Settings of the command line for every device; None: the robot file's, or the factory's."""

    firmware: int | None = None
    baud: int | None = None
    return_delay_us: int | None = None


@dataclass(frozen=True, slots=True)
class EncoderFrame:
    """Conversion of the position of a bare encoder to the position register, in counts."""

    direction: int = 1
    shift: int = 0  # whole turns and the homing offset

    def shown(self, place: int) -> int:
        """Return the register value at that encoder position."""
        return self.direction * place + self.shift


class VirtualDevice(Protocol):
    """Description of a virtual device, as far as every family's has it."""

    @property
    def id(self) -> int:
        """Its id on the bus."""

    @property
    def model(self) -> str:
        """Its model, as in the driver's table."""

    @property
    def hinge(self) -> Hinge | None:
        """The joint that it turns."""


@dataclass(frozen=True, slots=True)
class JointDevice:
    """The joint that a device turns. Counts are the bare encoder's."""

    joint: JointSpec  # as it is wired
    id: int  # of the device: another joint's where ids are exchanged
    zero: int  # at joint angle 0
    hinge: Hinge
    truth: JointGroundTruth
    start: int  # in the rest pose


@dataclass(frozen=True, slots=True)
class RobotBusRequest:
    """The joints of one bus, whose devices are to be described."""

    bus: BusSpec
    joints: Sequence[JointDevice]
    options: DeviceOptions


@dataclass(frozen=True, slots=True)
class BenchRequest:
    """A device of `--servo`. `version`: the firmware as it is written; None: not given."""

    text: str  # the whole option, for errors
    id: str
    model: str
    version: str | None
    options: DeviceOptions


@dataclass(frozen=True, slots=True)
class PhysicsRequest:
    """The motion of the devices of one bus: by a body, or (None) without load."""

    body: MujocoPhysics | None
    places: Sequence[int]  # of its joints among those of the robot
    start: Sequence[float]  # counts
    hinges: Sequence[Hinge | None]
    now: float


@dataclass(frozen=True, slots=True)
class VirtualBusRequest:
    """One bus to be made. `rate`: bit/s; None: the factory's."""

    name: str
    devices: Sequence[Any]
    physics: Any
    line: BusTiming
    rate: int | None
    now: float
    sensor: VirtualSensor | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class VirtualTwin:
    """Makers of virtual devices and buses. They raise InvalidInput for what cannot be simulated."""

    robot_devices: Callable[[RobotBusRequest], Sequence[tuple[Any, EncoderFrame]]]  # in joint order
    bench_device: Callable[[BenchRequest], Any]
    identity: Callable[[Any], IdentifiedDevice]  # of a device, as far as a calibration records it
    physics: Callable[[PhysicsRequest], Any]
    # Devices of the command line, alone: as laid out by the seed, and their positions in counts.
    laid_out: Callable[[Sequence[Any], int], tuple[Sequence[Any], list[float]]]
    bus: Callable[[VirtualBusRequest], ServableBus]
    faults: FaultArguments  # orders of its buses, as the methods of `ServableBus.faults`
    place_unit: float = 1.0  # unit of the physics' positions, in counts
    truth_keys: Collection[str] = ()  # keys of `JointGroundTruth` that its devices have; empty: all
    refuse_truth: Callable[[JointSpec, JointGroundTruth], None] = lambda joint, truth: None
    takes_more: bool = False  # devices of the command line may share a robot's bus


def twin_of(driver: DriverFamily) -> VirtualTwin:
    """Return the virtual twin of a family, imported."""
    found: VirtualTwin = driver.virtual.load()
    return found
