"""The nouns of the robot file: buses, actuator types, joints, the robot. Frozen; read by `robot_file.py`."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from twind.config.actuator_types import TypeSpec
from twind.config.collision_config import Clearance
from twind.config.homing_config import HomingSettings, JointEndstops
from twind.config.identified_spec import IdentifiedJoint, IdentifiedModel, ParameterEstimate
from twind.config.power_config import ButtonSpec, RelaySpec
from twind.robot.fall_settings import FallSettings
from twind.robot.transmission import Transmission


@dataclass(frozen=True, slots=True)
class BusSpec:
    """One bus and the port it is reached by."""

    name: str
    kind: str  # its driver family
    port: str | None  # None: given by the settings or on the command line
    baud: int  # bit/s; of a CAN bus what its file calls `bitrate`
    latency_timer_ms: int  # of the adapter; 0: it has none (an on-board port)
    one_write: bool = True  # goals and the next read request leave in one system call


@dataclass(frozen=True, slots=True)
class ActuatorSlot:
    """One actuator: where it hangs, what it is, how its counts become an angle."""

    name: str  # its own under `actuators`, else that of the joint it turns
    bus: str
    id: int
    type: TypeSpec
    sign: int  # +1 or -1
    ratio: float  # actuator turns per turn of what it drives, > 0
    registers: Mapping[str, int]
    mode: str
    feedback_id: int | None


@dataclass(frozen=True, slots=True)
class TransmissionSpec:
    """Joints that as many actuators of one bus turn together, both in the order of the file."""

    name: str
    kind: str  # differential or linkage_table
    bus: str
    actuators: tuple[str, ...]
    joints: tuple[str, ...]
    law: Transmission
    condition: float  # the worst number of its Jacobian
    residual: float = 0.0  # rad, of inverse(forward(x)) - x; of a table
    table: Path | None = None
    table_sha256: str = ""  # of the table's file


@dataclass(frozen=True, slots=True)
class JointSpec:
    """One joint and its actuator slot.

    A joint of a transmission sits on one of its actuators, so that there are as many slots as joints: bus,
    id, type, sign, ratio, registers and mode are that actuator's alone, limits are the joint's.
    """

    name: str
    model_joint: str
    bus: str
    id: int
    type: TypeSpec
    sign: int  # +1 or -1
    ratio: float  # actuator turns per joint turn, > 0
    lower: float  # rad
    upper: float  # rad
    velocity_limit: float  # rad/s, the tightest of type and joint
    acceleration_limit: float  # rad/s²
    registers: Mapping[str, int]  # of the type, overridden by the joint
    actuator: str  # the slot's, by whose name it is calibrated; the joint's own, where it has one
    mode: str = "position"  # of the joint, else of its type
    # Id of the frames that a CAN actuator answers with; None: its family answers with its own id.
    feedback_id: int | None = None
    transmission: str = ""  # that turns the joint; empty: its actuator alone does
    travel: tuple[float, float] | None = None  # of `span`, where a transmission turns the joint
    stops: JointEndstops = field(default_factory=JointEndstops)
    homing: HomingSettings | None = None
    own_follow_rad: float | None = None  # None: as of its type
    own_follow_s: float | None = None

    @property
    def follow_rad(self) -> float | None:
        """Distance that the joint may be behind its goal, rad (FOLLOW_ERR); None: not in the file."""
        return self.type.follow_rad if self.own_follow_rad is None else self.own_follow_rad

    @property
    def follow_s(self) -> float | None:
        """Time that it may be so far behind, s; None: not in the file."""
        return self.type.follow_s if self.own_follow_s is None else self.own_follow_s

    @property
    def span(self) -> tuple[float, float]:
        """Range of the slot while its joints keep their limits, rad after sign and ratio."""
        return (self.lower, self.upper) if self.travel is None else self.travel

    @property
    def reach(self) -> float:
        """Expected travel of the slot from end to end, rad: from stop to stop where both are described."""
        low = self.stops.lower
        high = self.stops.upper
        return self.span[1] - self.span[0] if low is None or high is None else high - low

    @property
    def operating_mode(self) -> int:
        """Mode that the actuator must report: register 11 of a servo; a CAN actuator takes commands."""
        return self.type.operating_mode(self.mode)

    @property
    def current_cap(self) -> int | None:
        """Goal current (102) in counts, the most the servo may use; None but in current-based position."""
        return self.type.current_cap(self.mode)


@dataclass(frozen=True, slots=True)
class GateSettings:
    """Defaults of the gate for requests without own values."""

    on_velocity: str  # `reject` or `retime`
    collision: Clearance = field(
        default_factory=Clearance
    )  # how close bodies may come (SELF_COLLISION, KEEP_OUT, LOOKAHEAD_COLLISION)
    on_torque: str = "warn"  # or `reject`: more torque than a joint can give (TORQUE_INFEASIBLE)
    contact_hold_nm: Mapping[str, float] = field(default_factory=dict)  # N·m by joint (CONTACT_HOLD)
    request_may_retime: bool = False  # the file does not say `on_velocity`: a request may choose `retime`


@dataclass(frozen=True, slots=True)
class RegistersSpec:
    """Numbers side by side in the registers of a sensor: value = (raw - zero) * lsb."""

    address: int  # of the first
    type: str  # of `imu.TYPES`, little-endian
    count: int
    size: int  # bytes of one
    lsb: float  # SI per count: rad/s, m/s², 1 of a quaternion
    zero: float  # raw, where the value is 0
    order: str  # as they follow each other: xyz, wxyz, xyzw

    @property
    def kind(self) -> str:
        """Type of one number, in numpy's notation: `<i2`."""
        return f"<{self.type[0]}{self.size}"

    @property
    def end(self) -> int:
        """The address behind the last."""
        return self.address + self.count * self.size


@dataclass(frozen=True, slots=True)
class ImuSpec:
    """An inertial sensor on a serial bus, at a site of the model."""

    bus: str
    id: int
    site: str
    rotation: tuple[float, ...] | None  # w x y z, from the sensor's axes to the base's; None: the site's own
    return_delay_us: float
    gyro: RegistersSpec
    acceleration: RegistersSpec
    quaternion: RegistersSpec | None  # None: the sensor tells no attitude, it is worked out

    @property
    def registers(self) -> tuple[RegistersSpec, ...]:
        """All that are read: gyro, acceleration, and the quaternion where there is one."""
        return tuple(each for each in (self.gyro, self.acceleration, self.quaternion) if each is not None)

    @property
    def span(self) -> tuple[int, int]:
        """Address and size of the block that holds them all."""
        first = min(each.address for each in self.registers)
        return first, max(each.end for each in self.registers) - first


@dataclass(frozen=True, slots=True)
class RobotFile:
    """One robot, as described. `joints` is in the order of the file: the joint order of the whole house."""

    name: str
    path: Path
    text_sha256: str  # of the file's text
    mjcf_path: Path
    mjcf: str  # its text
    base: str  # body that the free joint carries
    support: str  # fixed, gantry or free
    rate_hz: float
    command_timeout_ms: float
    buses: tuple[BusSpec, ...]
    joints: tuple[JointSpec, ...]
    passive: tuple[str, ...]  # model joints that no actuator drives
    legs: tuple[str, ...]  # joints that carry the robot; where the file is silent, all of them
    poses: Mapping[str, Mapping[str, float]]  # rad, every joint; `rest` is always there
    gate: GateSettings
    motions: Path  # folder of trajectory files
    transmissions: tuple[TransmissionSpec, ...] = ()
    compensate_gravity: bool = False  # goals have an offset against gravity
    imu: ImuSpec | None = None
    fall: FallSettings | None = None  # None: falls are not detected
    relay: RelaySpec | None = None  # of the motors' supply
    stop_button: ButtonSpec | None = None
    todo: tuple[str, ...] = ()  # keys of the file that are not settled yet
    identified: IdentifiedModel | None = None  # measured of this individual, from a file of its own

    @property
    def names(self) -> tuple[str, ...]:
        """Joint names in order."""
        return tuple(joint.name for joint in self.joints)

    @property
    def identified_joints(self) -> Mapping[str, IdentifiedJoint]:
        """Identified joints by name, with their stiffness at the present gains."""
        found = {} if self.identified is None else self.identified.joints
        return {
            joint.name: found[joint.name].at_gain(joint.type.p_gain)
            for joint in self.joints
            if joint.name in found
        }

    def estimates(self, parameter: str) -> Mapping[str, ParameterEstimate]:
        """Identified estimates of one parameter, by joint; none without an identified model."""
        found = {name: joint.estimates() for name, joint in self.identified_joints.items()}
        return {name: each[parameter] for name, each in found.items() if parameter in each}

    @property
    def description_sha256(self) -> str:
        """Hash that binds a calibration: every actuator's name, bus, id, sign, ratio and ticks per turn, and
        what transmissions make of them."""
        rows = sorted(
            f"{j.actuator} {j.bus} {j.id} {j.sign:+d} {j.ratio!r} {j.type.ticks_per_turn}\n"
            for j in self.joints
        )
        rows += sorted(
            f"{' '.join(t.joints)} by {' '.join(t.actuators)}: {t.law} {t.table_sha256}\n"
            for t in self.transmissions
        )
        return hashlib.sha256("".join(rows).encode()).hexdigest()

    def bus(self, name: str) -> BusSpec:
        """The bus of that name. Raises KeyError."""
        return {bus.name: bus for bus in self.buses}[name]
