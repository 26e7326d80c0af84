"""Specification of one virtual robot: the zeros of its devices, their settings, the calibration that fits.

Runs in `twind-virtual`. The zeros differ from servo to servo, so that a missing or wrong calibration shows.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

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
from twind.config.driver_family import family, family_of
from twind.config.robot_spec import BusSpec, ImuSpec, JointSpec, RobotFile
from twind.config.travel import range_to_stops
from twind.exceptions import InvalidInput
from twind.robot.arrays import Floats
from twind.robot.attitude import Quaternion, matrix, product
from twind.robot.joint_state import Imu
from twind.twin.base_pose import UPRIGHT
from twind.twin.base_support import BY_TORQUE
from twind.twin.imu_model import mount_of, still
from twind.twin.mujoco_physics import MujocoPhysics, body_of
from twind.version import __version__
from twind.virtual.joint_actuators import hinge_of, zero_of
from twind.virtual.robot_ground_truth import (
    RobotGroundTruth,
    mechanical_stops,
    model_stops,
    refuse_impossible,
)
from twind.virtual.virtual_twin import (
    BusTiming,
    DeviceOptions,
    EncoderFrame,
    JointDevice,
    PhysicsRequest,
    RobotBusRequest,
    VirtualBusRequest,
    VirtualTwin,
    twin_of,
)
from twind_drivers.register_sensor import SensorField
from twind_drivers.virtual.hinge import Hinge
from twind_drivers.virtual.servable_bus import ServableBus
from twind_drivers.virtual.virtual_sensor import SensorRegisters, VirtualSensor


@dataclass(frozen=True)
class VirtualRobotSpec:
    """A robot file and the ground truth of one robot built after it."""

    robot: RobotFile  # as described
    zeros: Mapping[str, int]  # of the bare encoder at joint angle 0, by joint
    devices: Mapping[str, tuple[Any, ...]]  # by bus, in joint order: a `VirtualDevice` of its family
    frames: Mapping[str, EncoderFrame] = field(default_factory=dict)  # by joint
    truth: RobotGroundTruth = field(default_factory=RobotGroundTruth)
    by_hand: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # by joint: travel by hand, rad

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
        every: list[Hinge | None] = [device.hinge for on in self.devices.values() for device in on]
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
    firmware: int | None = None,
    truth: RobotGroundTruth | None = None,
) -> VirtualRobotSpec:
    """Devices that a robot file describes. Raises InvalidInput: rate, delay, travel or truth that cannot be.

    `truth`: deviations from the file; with it every shaft has mechanical stops. None: no deviations.
    """
    known = truth or RobotGroundTruth()
    refuse_impossible(robot, known)
    _refuse_unknown_keys(robot, known)
    ends = {} if truth is None else mechanical_stops(robot, known)
    wired = [replace(joint, sign=_sign(joint, known)) for joint in robot.joints]
    stops = ends or model_stops(robot)
    by_hand = {joint.name: range_to_stops(joint, stops[joint.name]) for joint in wired}
    zeros = {
        joint.name: zero_of(robot.name, joint, known.joint_truth(joint.name), by_hand[joint.name])
        for joint in wired
    }
    ids = {joint.name: joint.id for joint in robot.joints}
    made = VirtualRobotSpec(robot, zeros, {}, truth=known)
    options = DeviceOptions(firmware, baud, return_delay_us)
    devices: dict[str, tuple[Any, ...]] = {}
    frames: dict[str, EncoderFrame] = {}
    for bus in robot.buses:
        twin = twin_of(family(bus.kind))
        joints = made.joints(bus.name)
        wanted = [
            JointDevice(
                joint,
                ids[known.holder(joint.name)],
                zeros[joint.name],
                hinge_of(joint, zeros[joint.name], ends, twin.place_unit),
                known.joint_truth(joint.name),
                start,
            )
            for joint, start in zip(joints, _start(made, bus), strict=True)
        ]
        found = twin.robot_devices(RobotBusRequest(bus, wanted, options))
        devices[bus.name] = tuple(device for device, _ in found)
        frames |= {joint.name: frame for joint, (_, frame) in zip(joints, found, strict=True)}
    return VirtualRobotSpec(robot, zeros, devices, frames, known, by_hand)


def _refuse_unknown_keys(robot: RobotFile, truth: RobotGroundTruth) -> None:
    """Raises InvalidInput for a key of the truth, or a register, that a joint's device has not."""
    for joint in robot.joints:
        twin = twin_of(family(joint.type.BUS))
        each = truth.joint_truth(joint.name)
        strange = [key for key in each.non_default_keys() if twin.truth_keys and key not in twin.truth_keys]
        if strange:
            why = f"a {joint.type.device} has no {strange[0]}; it has {', '.join(twin.truth_keys)}"
            raise InvalidInput(f"truth: {joint.name}: {why}")
        twin.refuse_truth(joint, each)


def _sign(joint: JointSpec, truth: RobotGroundTruth) -> int:
    return truth.joint_truth(joint.name).sign or joint.sign


def calibration(made: VirtualRobotSpec) -> Calibration:
    """Return the calibration file that fits: the result of a perfect sweep and zero of these servos.

    It has the robot file's signs, right or wrong: only a proof shows that. Where ids are exchanged it has for
    each joint the values of the servo with its id.
    """
    devices = {
        (bus.name, each.id): twin_of(family(bus.kind)).identity(each)
        for bus in made.robot.buses
        for each in made.devices[bus.name]
    }
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
        ends = made.by_hand[holder]
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


def buses(
    made: VirtualRobotSpec,
    *,
    physics: bool = True,
    body: MujocoPhysics | None = None,
    now: float = 0.0,
    line: BusTiming | None = None,
    extra: Mapping[str, Sequence[Any]] | None = None,
) -> dict[str, ServableBus]:
    """Make the buses of a virtual robot, in its rest pose with torque off. One body moves all of them.

    `body`: that one, else with `physics` one is made, held upright.
    `extra`: devices beside those of the robot, by bus.
    Raises InvalidInput for a bus that cannot take them, or, with `physics`, for `extra` on a body's bus.
    """
    extra = extra or {}
    _require_takers(made.robot, extra)
    if physics and body is None:
        body = body_for(made, now=now)
    if extra and body is not None:
        raise InvalidInput("servos beside those of a robot have no body: say --muscles first-order")
    line = line or BusTiming()
    virtual: dict[str, ServableBus] = {}
    for bus in made.robot.buses:
        own = made.devices[bus.name]
        beside, stand = _twin(bus).laid_out(extra.get(bus.name, ()), line.seed)
        moved = _moved(made, bus, body, now, stand)
        sensor = sensor_of(made.robot, bus.name, body)
        request = VirtualBusRequest(bus.name, [*own, *beside], moved, line, bus.baud, now, sensor)
        virtual[bus.name] = _twin(bus).bus(request)
    return virtual


def _require_takers(robot: RobotFile, extra: Mapping[str, Sequence[Any]]) -> None:
    """Raises InvalidInput for devices beside the robot's own where no bus takes them."""
    kinds = {bus.name: bus.kind for bus in robot.buses}
    takers = {bus.name: bus for bus in robot.buses if _twin(bus).takes_more}
    for name, devices in extra.items():
        if name in kinds and name not in takers:
            raise InvalidInput(f"{name} is a bus of kind {kinds[name]}: it takes no further devices")
        if name not in takers:
            raise InvalidInput(f"no bus {name!r}; {robot.name} has {', '.join(takers)}")
        for device in devices:
            if (kind := family_of(device.model).kind) != takers[name].kind:
                raise InvalidInput(f"{device.model} {device.id} is of kind {kind}: bus {name} is of another")


def _twin(bus: BusSpec) -> VirtualTwin:
    return twin_of(family(bus.kind))


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


def _moved(
    made: VirtualRobotSpec, bus: BusSpec, body: MujocoPhysics | None, now: float, beside: list[float]
) -> Any:
    """Build the physics of one bus; `beside`: counts of the devices that belong to no joint."""
    hinges = [device.hinge for device in made.devices[bus.name]] + [None] * len(beside)
    start = [*map(float, _start(made, bus)), *beside]
    return _twin(bus).physics(PhysicsRequest(body, _places(made, bus), start, hinges, now))


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
