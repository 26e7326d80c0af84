"""What was seen of the buses, on the free port or through the daemon. Data alone, for the checks.

A value that nobody could tell is missing from `values`, never a zero.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

from twind.config.actuator_types import CanType
from twind.config.robot_spec import BusSpec, ImuSpec, JointSpec
from twind.doctor.check import Devices
from twind_drivers.dynamixel.bus_scan import ScannedDevice as Answer
from twind_drivers.dynamixel.bus_scan import Trouble
from twind_drivers.dynamixel.control_tables import number_of
from twind_drivers.dynamixel.dynamixel_identification import SETTINGS

# Registers that the checks compare, in snake case. A model that lacks one is not asked for it.
RAM = (
    "torque_enable",
    "status_return_level",
    "hardware_error_status",
    "bus_watchdog",
    "profile_acceleration",
    "profile_velocity",
    "present_input_voltage",
    "present_temperature",
)
EEPROM = tuple(name for name in SETTINGS if name not in RAM)
MAPPED = "indirect_address_"  # and the number of the entry, from 1
# Of CAN actuators, by family: what the checks compare and the family tells.
PARAMETERS: Mapping[str, tuple[str, ...]] = {
    "damiao": ("position_range", "velocity_range", "torque_range", "mode", "timeout"),
    "robstride": ("run_mode", "timeout", "bus_voltage"),
    "odrive": ("bus_voltage",),
    "cubemars": (),
}
MUTE = ("cubemars",)  # families that answer nobody who does not command


@dataclass(frozen=True, slots=True, eq=False)
class SurveyedServo:
    """One id that answered on a serial bus at its rate."""

    bus: str
    id: int
    joint: JointSpec | None  # None: the robot file knows nobody of that id there
    model: int | None
    model_name: str | None  # None: in no table
    firmware: int | None
    values: Mapping[str, int] = field(default_factory=dict)  # register -> counts, signed where it is
    trouble: Trouble | None = None  # why this seems to be two devices; None: it does not
    delay: float | None = None  # s that its quickest answer took beside the wire's time; None: not measured

    @property
    def thing(self) -> Devices:
        """As people name it."""
        return Devices(self.bus, [(self.id, "" if self.joint is None else self.joint.name)])

    @property
    def is_expected_model(self) -> bool:
        """It is of the model that its joint has: only then do its registers mean what the robot file says."""
        return self.joint is not None and self.model == number_of(self.joint.type.device)


def device_of(joint: JointSpec) -> Devices:
    """The device that a joint should have, whether it answers or not."""
    return Devices(joint.bus, [(joint.id, joint.name)])


def thing_of(imu: ImuSpec) -> str:
    """As people name it."""
    return f"bus {imu.bus} id {imu.id} (IMU)"


@dataclass(frozen=True, slots=True, eq=False)
class SurveyedImu:
    """The IMU of a bus."""

    thing: str  # as people name it
    heard: bool
    force: float | None = None  # m/s², the size of what it feels; None: not heard


@dataclass(frozen=True, slots=True, eq=False)
class SerialSurvey:
    """One serial bus."""

    spec: BusSpec
    port: str
    servos: tuple[SurveyedServo, ...]  # in order of ids
    missing: tuple[JointSpec, ...]  # in the order of the robot file
    elsewhere: tuple[Answer, ...] = ()  # who answered at other rates; looked for where somebody is missing
    troubles: tuple[Trouble, ...] = ()  # of the line as a whole
    asked: int = 0  # pings of which each answer was looked at
    garbled: int = 0  # of those: bytes came, and no sound answer, or more than it
    lost: int = 0  # of those: nothing came though others were answered
    imu: SurveyedImu | None = None  # None: the robot file describes none there

    @property
    def described_servos(self) -> tuple[SurveyedServo, ...]:
        """Those that are a joint's, one of each id."""
        return tuple(servo for servo in self.servos if servo.joint is not None and not servo.trouble)


@dataclass(frozen=True, slots=True, eq=False)
class SurveyedCanActuator:
    """One actuator of a CAN bus that answered."""

    bus: str
    joint: JointSpec
    values: Mapping[str, int] = field(default_factory=dict)  # parameter -> number, a float in thousandths
    torque: int = -1  # 1 on, 0 off, -1 it does not tell
    faults: tuple[str, ...] = ()  # what it says is wrong with it, in words
    twice: bool = False  # more answers than one came of it

    @property
    def thing(self) -> Devices:
        """As people name it."""
        return device_of(self.joint)


@dataclass(frozen=True, slots=True)
class CanSurvey:
    """One CAN bus."""

    spec: BusSpec
    port: str
    nodes: tuple[SurveyedCanActuator, ...]
    missing: tuple[JointSpec, ...]  # without those that could not answer: `asked`
    condition: str = ""  # what is wrong with the controller; "": nothing, or it cannot tell
    masters: int = 0  # frames of another master that came while nobody was asked
    strangers: int = 0  # frames of nobody that the robot file knows


def is_queried(joint: JointSpec) -> bool:
    """Does its CAN actuator answer a question? A CubeMars in MIT mode answers commands alone."""
    return isinstance(joint.type, CanType) and joint.type.family not in MUTE
