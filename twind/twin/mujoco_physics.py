"""MuJoCo as the muscles of virtual servos: one body for all buses, 500 steps a second.

Torque is in servo units. Runs in `twind-virtual` (and in tests). It handles neither packets nor registers,
only encoder ticks, gains as in the registers and raw currents. It has the interface
`twind_drivers.virtual.servo_physics.ServoPhysics` without importing it, which the layers do not allow here.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import mujoco
import numpy as np

from twind.config.robot_spec import RobotFile
from twind.exceptions import InvalidInput, OperationFailed
from twind.robot.arrays import Bools, Floats
from twind.robot.joint_state import Imu
from twind.twin.base_pose import BASES, UPRIGHT, gravity, lay_down
from twind.twin.base_support import BY_TORQUE, BaseHold, BaseSupport, hang
from twind.twin.identified_model import apply_identified
from twind.twin.imu_model import ImuModel, feel, require_site
from twind.twin.motor_drive import MotorDrive
from twind.twin.pinning import pin
from twind.twin.servo_motor import STEP, MotorControlLoops, Places, ServoMotor
from twind.twin.tendon_coupling import PREFIX, MotorGroup, strung

__all__ = ["BusPhysics", "MujocoPhysics", "OperationFailed", "ServoMotor", "body_of"]
# s without torque before time begins, at most; rad/s that count as rest
SETTLE = 20.0
STILL = 1e-3


class MujocoPhysics:
    """All motors of one body. Arrays are (n,), in the order of `motors`; see `part` for those of one bus."""

    def __init__(
        self,
        spec: mujoco.MjSpec,
        motors: Sequence[ServoMotor],
        *,
        pinned: bool,
        stands: BaseHold | None = None,
        site: str | None = None,
        groups: Sequence[MotorGroup] = (),
        start: Mapping[str, float] | None = None,
        now: float = 0.0,
    ) -> None:
        """`start`: angles (rad) by model joint, torque off; it comes to rest before time begins at `now`.

        `pinned` removes the free joint; `stands`: hold of a base that keeps it; `site`: place of an inertial
        sensor; `groups`: motors that drive joints together. Raises KeyError for a motor whose joint the model
        lacks, InvalidInput for a model that does not compile, OperationFailed for one that breaks down.
        """
        self._warnings: list[str] = []
        mujoco.set_mju_user_warning(self._warnings.append)  # else MuJoCo writes MUJOCO_LOG.TXT
        self.model = model = _compile(spec, motors, groups, pinned=pinned, stands=stands, site=site)
        self.data = data = mujoco.MjData(model)
        for name, angle in (start or {}).items():
            data.qpos[model.joint(name).qposadr[0]] = angle
        self._loops = MotorControlLoops(model, motors, groups)
        self.crane = None if stands is None else BaseSupport(model, data, stands)
        self._felt = None if site is None else ImuModel(model, data, site)
        self._everyone = np.arange(len(motors))
        self.position, self.velocity, self.current, self.pwm = (np.zeros(len(motors)) for _ in range(4))
        self._settle()
        self._time = now

    def imu(self) -> Imu:
        """Return the current reading of the base's IMU. Raises ValueError: this body has none."""
        if self._felt is None:
            raise ValueError("this body has no inertial sensor")
        return self._felt.read_imu(self._time)

    def _settle(self) -> None:
        self._time = -SETTLE
        for second in range(1, int(SETTLE) + 1):
            self.advance(second - SETTLE)
            if np.abs(self.data.qvel).max(initial=0.0) < STILL:
                return

    def part(self, places: Sequence[int]) -> "BusPhysics":
        """Return the motors of one bus, by their places in `motors`."""
        return BusPhysics(self, self._loops, np.asarray(places, np.intp))

    def impedance(self, places: Sequence[int]) -> "CanBusPhysics":
        """Return the CAN actuators of one bus, by their places in `motors`."""
        return CanBusPhysics(self, self._loops, np.asarray(places, np.intp))

    def drive(self, drive: MotorDrive) -> None:
        """Set torque, mode, gains and caps; see `twind_drivers.virtual.servo_physics`."""
        self._loops.drive(self._everyone, drive)

    def set_goals(self, goal: Floats) -> None:
        """Set goals (n,) in the units of the modes: encoder ticks, raw velocity, current or PWM."""
        self.data.ctrl[:] = self._loops.set_goals(self._everyone, goal)

    def block(self, held: Bools) -> None:
        """Block the joints `held` (n,)."""
        self._loops.block(self._everyone, held)

    def set_hand_positions(self, place: Floats, speed: Floats) -> None:
        """Set where hands hold limp joints, encoder ticks, ticks/s; NaN: not held."""
        self._loops.grip(self._everyone, place, speed)

    def set_base_pose(self, base: str) -> None:
        """Hold the base in a pose of `base_pose.BASES` from now on. Raises KeyError for another name."""
        if base not in BASES:
            raise KeyError(f"lay: no base {base!r}; there are {', '.join(BASES)}")
        self.model.opt.gravity[:] = gravity(base, self.model.opt.gravity)

    def advance(self, now: float) -> None:
        """Step the body until `now` (s), to 2 ms. Raises OperationFailed."""
        steps = int((now - self._time) / STEP + 1e-6)
        if steps < 1:
            return
        self._time += steps * STEP
        data = self.data
        crane = self.crane
        if crane is not None:
            crane.watch(self._loops.on, self._time)
        if self._loops.busy or (crane is not None and crane.pushing):
            for _ in range(steps):
                self._loops.step(data)
                mujoco.mj_step(self.model, data)
                if crane is not None:
                    crane.stepped()
        else:
            data.qfrc_applied[self._loops.v] = 0.0
            mujoco.mj_step(self.model, data, steps)
        if np.count_nonzero(data.warning.number):
            raise OperationFailed(
                f"virtual body at {self._time:.3f} s: {self._warnings[:1] or 'a MuJoCo warning'}"
            )
        self._read()

    def _read(self) -> None:
        readings = self._loops.read(self.data)
        self.position[:], self.velocity[:], self.current[:], self.pwm[:] = readings


class _PartPhysics:
    """Some of the motors of a body, by their places `at`."""

    def __init__(self, whole: MujocoPhysics, loops: MotorControlLoops, at: Places) -> None:
        self.whole = whole
        self._loops = loops
        self._at = at

    def block(self, held: Bools) -> None:
        """Block the joints `held` (m,)."""
        self._loops.block(self._at, held)

    def set_base_pose(self, base: str) -> None:
        """See `MujocoPhysics.set_base_pose`; it applies to the whole body."""
        self.whole.set_base_pose(base)


class BusPhysics(_PartPhysics):
    """The motors of one bus: the interface of `MujocoPhysics` for m of its n motors."""

    def __init__(self, whole: MujocoPhysics, loops: MotorControlLoops, at: Places) -> None:
        super().__init__(whole, loops, at)
        self.position = whole.position[at]
        self.velocity = whole.velocity[at]
        self.current = whole.current[at]
        self.pwm = whole.pwm[at]

    def drive(self, drive: MotorDrive) -> None:
        """See `MujocoPhysics.drive`."""
        self._loops.drive(self._at, drive)

    def set_goals(self, goal: Floats) -> None:
        """See `MujocoPhysics.set_goals`."""
        self.whole.data.ctrl[self._at] = self._loops.set_goals(self._at, goal)

    def set_hand_positions(self, place: Floats, speed: Floats) -> None:
        """See `MujocoPhysics.set_hand_positions`."""
        self._loops.grip(self._at, place, speed)

    def advance(self, now: float) -> None:
        """Advance the whole body to `now` (s); the other buses get its state with their own call."""
        self.whole.advance(now)
        for name in ("position", "velocity", "current", "pwm"):
            getattr(self, name)[:] = getattr(self.whole, name)[self._at]


class CanBusPhysics(_PartPhysics):
    """The CAN actuators of one bus. Arrays (m,), SI.

    It has the interface `twind_drivers.virtual.can.can_motor_physics.CanMotorPhysics`.
    """

    def __init__(self, whole: MujocoPhysics, loops: MotorControlLoops, at: Places) -> None:
        super().__init__(whole, loops, at)
        self.position, self.velocity, self.torque = loops.read_shafts(whole.data, at)
        self._gains = np.full((4, at.size), np.nan)  # on, kp, kd, limit as the physics has them

    def drive(
        self,
        on: Bools,
        position: Floats,
        velocity: Floats,
        kp: Floats,
        kd: Floats,
        torque: Floats,
        limit: Floats,
    ) -> None:
        """Set the last command of each (rad, rad/s, N·m/rad, N·m·s/rad, N·m), within `limit` N·m."""
        gains = np.stack([on, kp, kd, limit])
        if not np.array_equal(gains, self._gains):
            self._gains = gains
            self._loops.impede(self._at, on, kp, kd, limit)
        self.whole.data.ctrl[self._at] = self._loops.steer(self._at, position, velocity, torque)

    def set_hand_positions(self, place: Floats, speed: Floats) -> None:
        """Set where hands hold limp shafts (rad, rad/s; NaN: not held); `drive` must follow."""
        self._loops.grip_shaft(self._at, place, speed)
        self._gains[:] = np.nan

    def advance(self, now: float) -> None:
        """Advance the whole body to `now` (s). Raises OperationFailed.

        The other buses get its state with their own call.
        """
        self.whole.advance(now)
        self.position[:], self.velocity[:], self.torque[:] = self._loops.read_shafts(
            self.whole.data, self._at
        )


def body_of(
    robot: RobotFile,
    zeros: Mapping[str, int],
    *,
    friction: Mapping[str, float] | None = None,
    stops: Mapping[str, tuple[float, float]] | None = None,
    base: str = UPRIGHT,
    hold: str = BY_TORQUE,
    now: float = 0.0,
) -> MujocoPhysics:
    """Return the body of a robot file in its rest pose. `zeros`: ticks at joint angle 0, by joint.

    `friction` (N·m), `stops` (rad): of joints where they differ from the model. `base`: its pose
    (`base_pose.BASES`); a lying one has a bench under it and does not move. `hold`: of `base_support.HOLDS`,
    for an upright robot with support free. Raises InvalidInput, OperationFailed.
    """
    rub = {name: each.value for name, each in robot.estimates("friction_nm").items()} | dict(friction or {})
    stiff = robot.estimates("stiffness_nm_per_rad").items()
    strength = {name: each.value / each.prior for name, each in stiff if each.prior > 0.0}  # of the figures
    ends = stops or {}
    motors = [
        ServoMotor.from_joint(
            joint,
            zeros[joint.name],
            friction=rub.get(joint.name, math.nan),
            strength=strength.get(joint.name, 1.0),
            stops=ends.get(joint.name),
        )
        for joint in robot.joints
    ]
    start = {joint.model_joint: robot.poses["rest"][joint.name] for joint in robot.joints}
    spec = mujoco.MjSpec.from_file(str(Path(robot.mjcf_path)))
    apply_identified(spec, robot)
    lay_down(spec, base, start)
    pinned = robot.support != "free" or base != UPRIGHT
    rows = [row for row, name in enumerate(robot.names) if name in robot.legs or not robot.legs]
    stands = None if pinned else BaseHold(robot.base, tuple(rows), hold)
    site = None
    if robot.imu is not None:
        site = robot.imu.site
        require_site(spec, robot, site)
    return MujocoPhysics(
        spec, motors, pinned=pinned, stands=stands, site=site, groups=_groups(robot), start=start, now=now
    )


def _groups(robot: RobotFile) -> list[MotorGroup]:
    places = {name: place for place, name in enumerate(robot.names)}
    groups = []
    for each in robot.transmissions:
        rows = tuple(places[name] for name in each.joints)
        groups.append(MotorGroup(each.law, rows, tuple(robot.joints[row].model_joint for row in rows)))
    return groups


def ranges_of(robot: RobotFile) -> Mapping[str, tuple[float, float]]:
    """Return the ranges (lower, upper) of the joints that the model bounds, rad, by joint name.

    Raises InvalidInput: it cannot be compiled.
    """
    try:
        model = mujoco.MjModel.from_xml_path(str(robot.mjcf_path))
    except ValueError as error:
        raise InvalidInput(f"{robot.mjcf_path}: {error}; correct it") from None
    bounded = {model.joint(at).name: model.jnt_range[at] for at in np.flatnonzero(model.jnt_limited)}
    return {
        joint.name: (float(bounded[joint.model_joint][0]), float(bounded[joint.model_joint][1]))
        for joint in robot.joints
        if joint.model_joint in bounded
    }


def _compile(
    spec: mujoco.MjSpec,
    motors: Sequence[ServoMotor],
    groups: Sequence[MotorGroup],
    *,
    pinned: bool,
    stands: BaseHold | None,
    site: str | None,
) -> mujoco.MjModel:
    """Compile the model with our motors instead of its own; sensors and key poses are removed with them.

    Raises KeyError, InvalidInput.
    """
    for element in [*spec.actuators, *spec.sensors, *spec.keys]:
        spec.delete(element)
    if pinned:
        for body in list(spec.bodies):
            pin(spec, body)
    if stands is not None:
        hang(spec, stands.base, STEP)
    if site is not None:
        feel(spec, site)
    names = {joint.name for joint in spec.joints}
    together = {row for group in groups for row in group.rows}
    for row, motor in enumerate(motors):
        if motor.joint not in names:
            raise KeyError(f"the model has no joint {motor.joint!r}; it has {', '.join(sorted(names))}")
        target = f"{PREFIX}{motor.joint}" if row in together else motor.joint
        actuator = spec.add_actuator(name=motor.joint, target=target)
        actuator.trntype = mujoco.mjtTrn.mjTRN_TENDON if row in together else mujoco.mjtTrn.mjTRN_JOINT
        actuator.gaintype = mujoco.mjtGain.mjGAIN_FIXED
        actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        actuator.forcelimited = True
        actuator.forcerange = [-1.0, 1.0]
        # Whatever the model's own servos inherit: N·m or rad/s are no angle, and a shaft has no range.
        actuator.ctrllimited = actuator.actlimited = False
        actuator.inheritrange = 0.0
        actuator.dyntype = mujoco.mjtDyn.mjDYN_NONE
        actuator.gear = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    spec.option.timestep = STEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    try:
        strung(spec, groups)
        return spec.compile()
    except ValueError as error:
        raise InvalidInput(f"model of the virtual body: {' '.join(str(error).split())}") from None
