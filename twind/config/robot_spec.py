"""The nouns of the robot file: buses, actuator types, joints, the robot. Frozen; read by `robot_file.py`."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from twind.config.section import Plain


@dataclass(frozen=True, slots=True)
class BusSpec:
    """One bus and the port it is reached by."""

    name: str
    kind: str  # `dynamixel2`
    port: str | None  # None: given by the settings or on the command line
    baud: int
    latency_timer_ms: int  # of the adapter; 0: it has none (an on-board port)


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
    mode: str  # `position`
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


@dataclass(frozen=True, slots=True)
class GateSettings:
    """What the gate may do by itself where a request does not say."""

    on_velocity: str  # `reject` or `retime`
    collision: Plain  # kept as it stands for the look-ahead


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
