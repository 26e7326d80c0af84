"""Specification of one virtual robot: its servos' zeros, their EEPROM, the calibration that fits.

Runs in `twind-virtual`. The zeros differ from servo to servo, so that a missing or wrong calibration shows.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path

import numpy as np

from twind.config.actuator_types import CAN
from twind.config.calibration_file import (
    Calibration,
    JointCalibration,
    dump_calibration,
    fitting,
    save_calibration,
    seam_margin,
    text_hash,
    turn_band,
)
from twind.config.counts import slot_angles, ticks_of, turn_start
from twind.config.robot_spec import BusSpec, ImuSpec, JointSpec, RobotFile
from twind.config.travel import sweep_range
from twind.exceptions import InvalidInput
from twind.robot.arrays import Floats
from twind.robot.attitude import Quaternion, matrix, product
from twind.robot.joint_state import Imu
from twind.twin.base_pose import UPRIGHT
from twind.twin.base_support import BY_TORQUE
from twind.twin.imu_model import mount_of, still
from twind.twin.mujoco_physics import MujocoPhysics, body_of
from twind.version import __version__
from twind.virtual.bench_servos import FIRMWARE, BusTiming, can_bus, laid_out, settings, virtual_bus
from twind.virtual.can_node_setup import device, node, unloaded
from twind.virtual.joint_actuators import (
    EncoderFrame,
    fenced,
    frames_of,
    hinge_of,
    servo_of,
    zero_of,
)
from twind.virtual.robot_ground_truth import RobotGroundTruth, mechanical_stops, refuse_impossible
from twind_drivers.bus import IdentifiedDevice
from twind_drivers.dynamixel.control_tables import number_of, table
from twind_drivers.dynamixel.register_sensor import SensorField
from twind_drivers.virtual.can.can_motor_physics import CanMotorPhysics, FirstOrderCanPhysics
from twind_drivers.virtual.can.node_spec import NodeSpec
from twind_drivers.virtual.hinge import Hinge
from twind_drivers.virtual.servable_bus import ServableBus
from twind_drivers.virtual.servo_physics import FirstOrderPhysics, ServoPhysics
from twind_drivers.virtual.virtual_sensor import SensorRegisters, VirtualSensor
from twind_drivers.virtual.virtual_servos import BAUDS, ServoSpec


@dataclass(frozen=True)
class VirtualRobotSpec:
    """A robot file and the ground truth of one robot built after it."""

    robot: RobotFile  # as described
    zeros: Mapping[str, int]  # of the bare encoder at joint angle 0, by joint
    servos: Mapping[str, tuple[ServoSpec, ...]]  # by serial bus, in joint order
    nodes: Mapping[str, tuple[NodeSpec, ...]] = field(default_factory=dict)  # by CAN bus, likewise
    frames: Mapping[str, EncoderFrame] = field(default_factory=dict)  # by joint
    truth: RobotGroundTruth = field(default_factory=RobotGroundTruth)

    @cached_property
    def wired(self) -> RobotFile:
        """The robot as it is wired: `sign` is how the bare encoder counts."""
        joints = tuple(replace(joint, sign=_sign(joint, self.truth)) for joint in self.robot.joints)
        return replace(self.robot, joints=joints)

    def joints(self, bus: str) -> list[JointSpec]:
        """The joints of one bus, in order, as they are wired."""
        return [joint for joint in self.wired.joints if joint.bus == bus]

    def hinge(self, joint: str) -> Hinge:
        """Return the hinge of a joint, by joint name."""
        every = [spec.hinge for on in self.servos.values() for spec in on]
        every += [spec.hinge for on in self.nodes.values() for spec in on]
        return next(hinge for hinge in every if hinge is not None and hinge.joint == joint)

    @property
    def shown(self) -> Mapping[str, int]:
        """Values of the position registers at joint angle 0, after a boot in the rest pose, by joint."""
        return {name: self.frames[name].shown(zero) for name, zero in self.zeros.items()}


def make_spec(
    robot: RobotFile,
    *,
    baud: int | None = None,
    return_delay_us: int | None = None,
    firmware: int = FIRMWARE,
    truth: RobotGroundTruth | None = None,
) -> VirtualRobotSpec:
    """Servos that a robot file describes. Raises InvalidInput: rate, delay, travel or truth that cannot be.

    `truth`: deviations from the file; with it every shaft has mechanical stops. None: no deviations.
    """
    known = truth or RobotGroundTruth()
    refuse_impossible(robot, known)
    ends = {} if truth is None else mechanical_stops(robot, known)
    wired = tuple(replace(joint, sign=_sign(joint, known)) for joint in robot.joints)
    zeros = {joint.name: zero_of(robot.name, joint, known.joint_truth(joint.name)) for joint in wired}
    hinges = {joint.name: hinge_of(joint, zeros[joint.name], ends) for joint in wired}
    made = VirtualRobotSpec(robot, zeros, {}, truth=known)
    ids = {joint.name: joint.id for joint in robot.joints}
    frames = {name: EncoderFrame() for name in robot.names}
    servos: dict[str, tuple[ServoSpec, ...]] = {}
    nodes: dict[str, tuple[NodeSpec, ...]] = {}
    for bus in robot.buses:
        joints = made.joints(bus.name)
        if bus.kind == CAN:
            nodes[bus.name] = tuple(replace(node(joint), hinge=hinges[joint.name]) for joint in joints)
            continue
        base = settings(baud or bus.baud, return_delay_us)
        bare = [
            servo_of(
                joint,
                hinges[joint.name],
                known.joint_truth(joint.name),
                ids[known.holder(joint.name)],
                base,
                firmware,
            )
            for joint in joints
        ]
        found = frames_of(bus.name, bare, _start(made, bus))
        frames |= {joint.name: frame for joint, frame in zip(joints, found, strict=True)}
        servos[bus.name] = tuple(
            fenced(spec, joint, zeros[joint.name], frame)
            for joint, frame, spec in zip(joints, found, bare, strict=True)
        )
    return VirtualRobotSpec(robot, zeros, servos, nodes, frames, known)


def _sign(joint: JointSpec, truth: RobotGroundTruth) -> int:
    return truth.joint_truth(joint.name).sign or joint.sign


def calibration(made: VirtualRobotSpec) -> Calibration:
    """Return the calibration file that fits: the result of a perfect sweep and zero of these servos.

    It has the robot file's signs, right or wrong: only a proof shows that. Where ids are exchanged it has for
    each joint the values of the servo with its id.
    """
    devices = {(bus, servo.id): _device(servo) for bus, servos in made.servos.items() for servo in servos}
    devices |= {(bus, each.id): device(each) for bus, nodes in made.nodes.items() for each in nodes}
    created = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    holders = {name: made.truth.holder(name) for name in made.robot.names}
    zeros = {name: made.shown[holder] for name, holder in holders.items()}
    tool = f"twind-virtual {__version__}"
    found = fitting(made.robot, zeros, devices, created=created, tool=tool)
    named = zip(made.robot.names, found.joints, strict=True)
    joints = tuple(_with_travel(made, entry, holders[name]) for name, entry in named)
    found = replace(found, joints=joints)
    return replace(found, sha256=text_hash(dump_calibration(found)))


def _with_travel(made: VirtualRobotSpec, entry: JointCalibration, holder: str) -> JointCalibration:
    """Add the travel of the servo that sits at joint `holder`: from stop to stop where it has any."""
    joint = made.wired.joints[made.robot.names.index(holder)]
    ends = made.hinge(holder).stops
    if not all(map(math.isfinite, ends)):
        ends = sweep_range(joint)
    places = (ticks_of(joint, made.zeros[holder], end) for end in ends)
    low, high = sorted(map(made.frames[holder].shown, places))
    turn = joint.type.ticks_per_turn
    return replace(
        entry,
        device=replace(entry.device, tag=made.truth.joint_truth(holder).tag),
        sweep_ticks=(low, high),
        seam_margin_ticks=seam_margin((low, high), turn, turn_start(joint.type)),
        turn_band_ticks=turn_band((low, high), turn),
    )


def save(made: VirtualRobotSpec, path: Path) -> None:
    """Write that file. Raises ConfigError, OSError, InvalidInput (not a `.yaml`)."""
    if path.suffix != ".yaml":
        raise InvalidInput(f"{path}: a calibration file is named NAME.yaml")
    save_calibration(calibration(made), path.parent, path.stem)


def _device(servo: ServoSpec) -> IdentifiedDevice:
    number = number_of(servo.model)
    registers = table(number, servo.firmware)
    keys = ("homing_offset", "drive_mode", "operating_mode", "min_position_limit", "max_position_limit")
    settings = {key: registers[key].rule.default or 0 for key in keys} | dict(servo.settings)
    return IdentifiedDevice(servo.id, number, registers.model, servo.firmware, settings)


def buses(
    made: VirtualRobotSpec,
    *,
    physics: bool = True,
    body: MujocoPhysics | None = None,
    now: float = 0.0,
    line: BusTiming | None = None,
    extra: Mapping[str, Sequence[ServoSpec]] | None = None,
) -> dict[str, ServableBus]:
    """Make the buses of a virtual robot, in its rest pose with torque off. One body moves all of them.

    `body`: that one, else with `physics` one is made, held upright.
    `extra`: servos beside those of the robot, by serial bus.
    Raises InvalidInput for a bus that the robot has not, or, with `physics`, for `extra` on a body's bus.
    """
    extra = extra or {}
    strange = sorted(set(extra) - set(made.servos))
    if strange:
        why = (
            "is a CAN bus: only a serial one takes servos beside its own" if strange[0] in made.nodes else ""
        )
        known = f"no bus {strange[0]!r}; {made.robot.name} has {', '.join(made.servos)}"
        raise InvalidInput(f"{strange[0]} {why}" if why else known)
    if physics and body is None:
        body = body_for(made, now=now)
    if extra and body is not None:
        raise InvalidInput("servos beside those of a robot have no body: say --muscles first-order")
    line = line or BusTiming()
    virtual: dict[str, ServableBus] = {}
    for spec in made.robot.buses:
        if spec.kind == CAN:
            moved = _can_muscles(made, spec, body, now)
            virtual[spec.name] = can_bus(
                spec.name, made.nodes[spec.name], moved, line, bitrate=spec.baud, now=now
            )
            continue
        own = made.servos[spec.name]
        beside, stand = laid_out(extra.get(spec.name, ()), line.seed)
        baud = BAUDS[own[0].settings["baud_rate"]] if own else spec.baud
        muscles = _muscles(made, spec, body, now, stand)
        sensor = sensor_of(made.robot, spec.name, body)
        virtual[spec.name] = virtual_bus(
            spec.name, [*own, *beside], muscles, line, baud=baud, now=now, sensor=sensor
        )
    return virtual


def body_for(
    made: VirtualRobotSpec, *, base: str = UPRIGHT, hold: str = BY_TORQUE, now: float = 0.0
) -> MujocoPhysics:
    """Build the whole body as it is wired, with friction and stops of the truth. `base`, `hold`: see
    `body_of`."""
    rubbing = {name: made.truth.joint_truth(name).friction_nm for name in made.robot.names}
    friction = {name: value for name, value in rubbing.items() if value is not None}
    alone = [joint.name for joint in made.robot.joints if not joint.transmission]
    ends = {name: made.hinge(name).stops for name in alone}
    stops = {name: end for name, end in ends.items() if all(map(math.isfinite, end))}
    return body_of(made.wired, made.zeros, friction=friction, stops=stops, base=base, hold=hold, now=now)


def _muscles(
    made: VirtualRobotSpec, bus: BusSpec, body: MujocoPhysics | None, now: float, beside: list[float]
) -> ServoPhysics:
    """Build the servo physics of one bus; `beside`: ticks of the servos that belong to no joint."""
    if body is not None:
        return body.part(_places(made, bus))
    muscles = FirstOrderPhysics(np.array([*map(float, _start(made, bus)), *beside]), now=now)
    fence(muscles, [spec.hinge for spec in made.servos[bus.name]] + [None] * len(beside))
    return muscles


def _can_muscles(
    made: VirtualRobotSpec, bus: BusSpec, body: MujocoPhysics | None, now: float
) -> CanMotorPhysics:
    if body is not None:
        return body.impedance(_places(made, bus))
    shafts = unloaded(_start(made, bus), now=now)
    fence(shafts, [spec.hinge for spec in made.nodes[bus.name]])
    return shafts


def fence(muscles: FirstOrderPhysics | FirstOrderCanPhysics, hinges: Sequence[Hinge | None]) -> None:
    """Joints without load end where their hinges do."""
    ends = [(-math.inf, math.inf) if hinge is None else hinge.ends() for hinge in hinges]
    lower, upper = np.array(ends, np.float64).reshape(-1, 2).T
    muscles.set_endstops(lower, upper)


def _places(made: VirtualRobotSpec, bus: BusSpec) -> list[int]:
    """Return the indices of the joints of a bus, in joint order."""
    return [at for at, joint in enumerate(made.robot.joints) if joint.bus == bus.name]


def _start(made: VirtualRobotSpec, bus: BusSpec) -> list[int]:
    """Counts of the joints of a bus in the rest pose."""
    rest = slot_angles(made.robot, made.robot.poses["rest"])
    return [ticks_of(joint, made.zeros[joint.name], rest[joint.name]) for joint in made.joints(bus.name)]


def sensor_of(robot: RobotFile, bus: str, body: MujocoPhysics | None) -> VirtualSensor | None:
    """The IMU of that bus, at the `body`, or (None) at a base that stands still; None: there is none."""
    imu = robot.imu
    if imu is None or imu.bus != bus:
        return None
    spec = imu
    turned = mount_of(robot, imu)

    def tell() -> list[Floats]:
        """Return the measurements of the body in the axes of the device."""
        return in_device(still(0.0) if body is None else body.imu(), spec, turned)

    cells = [
        SensorRegisters(SensorField(each.address, each.kind, each.count), each.lsb, each.zero)
        for each in imu.registers
    ]
    return VirtualSensor(imu.id, cells, tell, return_delay=imu.return_delay_us * 1e-6)


def in_device(measured: Imu, imu: ImuSpec, turned: Quaternion) -> list[Floats]:
    """Field by field, in the device's own axes and order. `turned`: from these axes to the base's."""
    back = matrix(turned).T
    values = [back @ measured.gyro, back @ measured.acceleration]
    if imu.quaternion is not None:
        w, x, y, z = measured.quaternion.tolist()
        w, x, y, z = product((w, x, y, z), turned)
        values.append(np.array((w, x, y, z) if imu.quaternion.order == "wxyz" else (x, y, z, w)))
    return values
