"""The nouns of the robot file: buses, actuator types, joints, the robot. Frozen; read by `robot_file.py`."""

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from twind.config.collision import Clearance
from twind.config.supply import Heat, Supply

# Name in the robot file -> value of the servo's register 11 (e-manual, "Operating Mode").
OPERATING_MODES: Mapping[str, int] = {
    "position": 3,
    "extended_position": 4,
    "current_based_position": 5,
}
MANY_TURNS = 1_048_575  # ticks: goals of the modes without position limits (e-manual, "Goal Position")


@dataclass(frozen=True, slots=True)
class BusSpec:
    """One bus and the port it is reached by."""

    name: str
    kind: str  # `dynamixel2`
    port: str | None  # None: given by the settings or on the command line
    baud: int
    latency_timer_ms: int  # of the adapter; 0: it has none (an on-board port)
    one_write: bool = True  # goals and the next read request leave in one system call


@dataclass(frozen=True, slots=True)
class Gains:
    """Position loop gains as register counts; they are written before torque and read back."""

    p: int
    i: int
    d: int


@dataclass(frozen=True, slots=True)
class TypeSpec:
    """One kind of actuator, shared by joints."""

    name: str
    device: str  # as the vendor's table spells it: XM430-W350
    mode: str  # one of OPERATING_MODES; a joint may have another
    return_delay_us: int
    ticks_per_turn: int
    gains: Gains
    torque_constant_nm_per_a: float  # NaN: effort unknown
    current_lsb_a: float
    velocity_lsb_rad_s: float
    velocity_limit_rad_s: float
    acceleration_limit_rad_s2: float
    current_limit_a: float  # NaN: unknown
    registers: Mapping[str, int]  # what a register must hold, by its name in snake case
    supply: Supply  # V that its servos bear
    heat: Heat  # °C, and for how long how much current


@dataclass(frozen=True, slots=True)
class JointSpec:
    """One joint and its actuator."""

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
    mode: str = "position"  # of the joint, else of its type

    @property
    def operating_mode(self) -> int:
        """What the servo's register 11 must hold."""
        return OPERATING_MODES[self.mode]

    @property
    def current_cap(self) -> int | None:
        """Goal current (102) in counts, the most the servo may use; None but in current-based position."""
        return cap_counts(self.type) if self.mode == "current_based_position" else None


def cap_counts(kind: TypeSpec) -> int | None:
    """`current_limit_a` of a type in counts of its servo, rounded down; None where it is not given."""
    if not math.isfinite(kind.current_limit_a):
        return None
    return math.floor(kind.current_limit_a / kind.current_lsb_a + 1e-9)  # 2.69 A is 1000 counts of 2.69 mA


@dataclass(frozen=True, slots=True)
class GateSettings:
    """What the gate may do by itself where a request does not say."""

    on_velocity: str  # `reject` or `retime`
    collision: Clearance = field(default_factory=Clearance)  # how close bodies may come (S23, S24, R20)
    on_torque: str = "warn"  # or `reject`: more torque than a joint can give (S25)


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

    @property
    def names(self) -> tuple[str, ...]:
        """Joint names in order."""
        return tuple(joint.name for joint in self.joints)

    @property
    def description_sha256(self) -> str:
        """What a calibration is bound to: joints, buses, ids, signs, ratios and ticks per turn, by name."""
        rows = sorted(
            f"{j.name} {j.bus} {j.id} {j.sign:+d} {j.ratio!r} {j.type.ticks_per_turn}\n" for j in self.joints
        )
        return hashlib.sha256("".join(rows).encode()).hexdigest()

    def bus(self, name: str) -> BusSpec:
        """The bus of that name. Raises KeyError."""
        return {bus.name: bus for bus in self.buses}[name]
