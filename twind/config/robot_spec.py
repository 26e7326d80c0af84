"""The nouns of the robot file: buses, actuator types, joints, the robot. Frozen; read by `robot_file.py`."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from twind.config.actuator import TypeSpec
from twind.config.collision import Clearance


@dataclass(frozen=True, slots=True)
class BusSpec:
    """One bus and the port it is reached by."""

    name: str
    kind: str  # `dynamixel2` or `can`
    port: str | None  # None: given by the settings or on the command line
    baud: int  # bit/s; of a CAN bus what its file calls `bitrate`
    latency_timer_ms: int  # of the adapter; 0: it has none (an on-board port)
    one_write: bool = True  # goals and the next read request leave in one system call


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
    # Id of the frames that a CAN actuator answers with; None: its family answers with its own id.
    feedback_id: int | None = None

    @property
    def operating_mode(self) -> int:
        """What the actuator must say: a servo in its register 11, a CAN actuator that it takes commands."""
        return self.type.operating_mode(self.mode)

    @property
    def current_cap(self) -> int | None:
        """Goal current (102) in counts, the most the servo may use; None but in current-based position."""
        return self.type.current_cap(self.mode)


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
