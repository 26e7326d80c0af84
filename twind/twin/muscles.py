"""MuJoCo as the muscles of virtual servos: one body for all buses, torque in servo units, 500 steps a second.

Runs in `twind-virtual` (and in tests); knows neither packets nor registers, only encoder ticks, gains as in
the registers and raw currents. Keeps `twind_drivers.virtual.muscles.Muscles` without importing it: rooms here
may not.

The motor is an XM430-W350 at 12 V (e-manual): position gain P makes P / 128 PWM counts per tick of error, 885
counts are full voltage, full voltage stalls at 4.1 N·m and runs free at 4.82 rad/s. P 800 so is 18.9 N·m/rad
at the shaft and back-EMF 0.85 N·m·s/rad. I and D act once a millisecond (assumed): I / 65536, D / 16.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from twind.config.robot_spec import JointSpec, RobotFile
from twind.robot.arrays import Bools, Floats

STEP = 0.002  # s
FULL_PWM = 885.0  # counts
STALL, FREE = 4.1, 4.82  # N·m, rad/s at full voltage
CYCLE = 0.001  # s, of the servo's own loop
SETTLE, STILL = 20.0, 1e-3  # s without torque before time begins, at most; rad/s that is rest
FRICTION, DAMPING = 0.05, 0.01  # N·m, N·m·s/rad: the least a gear of 353:1 has
TORQUE_CONSTANT = 1.78  # N·m/A where the robot file does not say (XM430-W350)


class Diverged(RuntimeError):
    """The physics produced a number that is none; MuJoCo has reset its state, so nothing may go on."""


@dataclass(frozen=True, slots=True)
class Motor:
    """One servo at one hinge of the model."""

    joint: str  # of the model
    zero: float  # encoder ticks at joint angle 0
    ticks: float  # per rad of the joint, signed
    ratio: float = 1.0  # shaft turns per joint turn
    speed_lsb: float = 0.229 * 2.0 * math.pi / 60.0  # rad/s of the shaft per raw velocity
    torque_lsb: float = TORQUE_CONSTANT * 0.00269  # N·m of the shaft per raw current
    stall: float = STALL  # N·m of the shaft at full voltage

    @classmethod
    def of(cls, joint: JointSpec, zero: int) -> "Motor":
        """The motor that a robot file describes. `zero`: ticks at joint angle 0."""
        kind = joint.type
        constant = kind.torque_constant_nm_per_a
        constant = constant if math.isfinite(constant) else TORQUE_CONSTANT
        limit = constant * kind.current_limit_a
        return cls(
            joint=joint.model_joint,
            zero=zero,
            ticks=joint.sign * joint.ratio * kind.ticks_per_turn / (2.0 * math.pi),
            ratio=joint.ratio,
            speed_lsb=kind.velocity_lsb_rad_s,
            torque_lsb=constant * kind.current_lsb_a,
            stall=limit if math.isfinite(limit) else STALL,
        )


class MujocoMuscles:
    """All motors of one body. Arrays are (n,), in the order of `motors`; see `part` for those of one bus."""

    def __init__(
        self,
        spec: mujoco.MjSpec,
        motors: Sequence[Motor],
        *,
        pinned: bool,
        start: Mapping[str, float] | None = None,
        now: float = 0.0,
    ) -> None:
        """`start`: angles (rad) by model joint, torque off; it comes to rest before time begins at `now`.

        `pinned` removes the free joint. Raises KeyError for a motor whose joint the model lacks.
        """
        self._warnings: list[str] = []
        mujoco.set_mju_user_warning(self._warnings.append)  # else MuJoCo writes MUJOCO_LOG.TXT
        self.model = model = _compile(spec, motors, pinned=pinned)
        self.data = data = mujoco.MjData(model)
        joints = [model.joint(motor.joint) for motor in motors]
        self._q = np.array([int(joint.qposadr[0]) for joint in joints], np.intp)
        self._v = np.array([int(joint.dofadr[0]) for joint in joints], np.intp)
        for name, angle in (start or {}).items():
            data.qpos[model.joint(name).qposadr[0]] = angle
        self._zero, self._ticks, self._ratio, self._speed_lsb, self._torque_lsb, self._stall = (
            np.array([getattr(motor, name) for motor in motors], np.float64)
            for name in ("zero", "ticks", "ratio", "speed_lsb", "torque_lsb", "stall")
        )
        self._way = np.copysign(1.0, self._ticks)
        self._damping = np.maximum(model.dof_damping[self._v], DAMPING)
        self._braking = self._stall / FREE * self._ratio**2  # N·m·s/rad: back-EMF, while powered
        model.dof_frictionloss[self._v] = np.maximum(model.dof_frictionloss[self._v], FRICTION)
        model.dof_solimp[self._v, :2] = 0.9999  # stiff friction: the soft default creeps 10 ticks/s
        model.dof_solref[self._v, 0] = 2.0 * STEP
        count = len(motors)
        self._goal, self._integral = np.zeros(count), np.zeros(count)  # rad; N·m
        self._ki, self._braked = np.zeros(count), np.zeros(count)
        self._pwm_per_rad, self._pwm_cap = np.zeros(count), np.zeros(count)
        self.position, self.velocity = np.zeros(count), np.zeros(count)
        self.current, self.pwm = np.zeros(count), np.zeros(count)
        off = np.zeros(count)
        self.drive(on=off > 0, p=off, i=off, d=off, pwm_cap=off, current_cap=off)
        self._settle()
        self._time = now

    def _settle(self) -> None:
        self._time = -SETTLE
        for second in range(1, int(SETTLE) + 1):
            self.advance(second - SETTLE)
            if np.abs(self.data.qvel).max(initial=0.0) < STILL:
                return

    def part(self, places: Sequence[int]) -> "Part":
        """The motors of one bus, by their places in `motors`."""
        return Part(self, np.asarray(places, np.intp))

    def drive(
        self, *, on: Bools, p: Floats, i: Floats, d: Floats, pwm_cap: Floats, current_cap: Floats
    ) -> None:
        """Torque on or off (m,), position gains as in the registers, caps of PWM and current (raw)."""
        everyone = np.arange(self._goal.size)
        self.drive_some(everyone, on=on, p=p, i=i, d=d, pwm_cap=pwm_cap, current_cap=current_cap)

    def drive_some(
        self,
        at: NDArray[np.intp],
        *,
        on: Bools,
        p: Floats,
        i: Floats,
        d: Floats,
        pwm_cap: Floats,
        current_cap: Floats,
    ) -> None:
        """`drive` of the motors `at`; the others keep what they have."""
        model, ratio = self.model, self._ratio[at]
        pwm_per_rad = np.where(on, p / 128.0, 0.0) * np.abs(self._ticks[at])
        torque_per_pwm = self._stall[at] / FULL_PWM * ratio  # N·m of the joint per count
        per_rad = np.abs(self._ticks[at]) * torque_per_pwm
        kp = pwm_per_rad * torque_per_pwm
        kd = np.where(on, d / 16.0, 0.0) * per_rad * CYCLE
        cap = np.minimum(pwm_cap * torque_per_pwm, current_cap * self._torque_lsb[at] * ratio)
        model.actuator_gainprm[at, 0] = kp
        model.actuator_biasprm[at, 1] = -kp
        model.actuator_biasprm[at, 2] = -kd
        model.actuator_forcerange[at] = np.stack([-cap, cap], axis=-1)
        self._braked[at] = np.where(on, self._braking[at], 0.0)
        model.dof_damping[self._v[at]] = self._damping[at] + self._braked[at]
        self._ki[at] = np.where(on, i / 65536.0, 0.0) * per_rad / CYCLE
        self._integral[at] = np.where(self._ki[at] > 0.0, self._integral[at], 0.0)
        self._pwm_per_rad[at], self._pwm_cap[at] = pwm_per_rad, pwm_cap

    def aim(self, goal: Floats) -> None:
        """Encoder ticks that the position loops pull to."""
        self.aim_some(np.arange(self._goal.size), goal)

    def aim_some(self, at: NDArray[np.intp], goal: Floats) -> None:
        """`aim` of the motors `at`."""
        self._goal[at] = (goal - self._zero[at]) / self._ticks[at]
        self.data.ctrl[at] = self._goal[at]

    def advance(self, now: float) -> None:
        """Step the body until `now` (s), to 2 ms. Raises Diverged."""
        steps = int((now - self._time) / STEP + 1e-6)
        if steps < 1:
            return
        self._time += steps * STEP
        data = self.data
        if np.count_nonzero(self._ki):
            for _ in range(steps):
                self._integrate()
                mujoco.mj_step(self.model, data)
        else:
            data.qfrc_applied[self._v] = 0.0
            mujoco.mj_step(self.model, data, steps)
        if np.count_nonzero(data.warning.number):
            raise Diverged(f"virtual body at {self._time:.3f} s: {self._warnings[:1] or 'a MuJoCo warning'}")
        self._read()

    def _integrate(self) -> None:
        """The I term of one step, held inside what the output cap could give."""
        data = self.data
        bound = self.model.actuator_forcerange[:, 1]
        grown = self._integral + self._ki * (self._goal - data.qpos[self._q]) * STEP
        self._integral = np.clip(grown, -bound, bound)
        data.qfrc_applied[self._v] = self._integral

    def _read(self) -> None:
        data = self.data
        angle, speed = data.qpos[self._q], data.qvel[self._v]
        self.position[:] = self._zero + angle * self._ticks
        self.velocity[:] = speed * self._ratio * self._way / self._speed_lsb
        torque = data.actuator_force + self._integral - self._braked * speed
        self.current[:] = torque * self._way / (self._ratio * self._torque_lsb)
        error = (self._goal - angle) * self._way * self._pwm_per_rad
        self.pwm[:] = np.clip(error, -self._pwm_cap, self._pwm_cap)


class Part:
    """The motors of one bus. Keeps the protocol of `MujocoMuscles` for m of its n motors."""

    def __init__(self, whole: MujocoMuscles, at: NDArray[np.intp]) -> None:
        self._whole, self._at = whole, at
        self.position, self.velocity = whole.position[at], whole.velocity[at]
        self.current, self.pwm = whole.current[at], whole.pwm[at]

    def drive(
        self, *, on: Bools, p: Floats, i: Floats, d: Floats, pwm_cap: Floats, current_cap: Floats
    ) -> None:
        """As `MujocoMuscles.drive`."""
        whole = self._whole
        whole.drive_some(self._at, on=on, p=p, i=i, d=d, pwm_cap=pwm_cap, current_cap=current_cap)

    def aim(self, goal: Floats) -> None:
        """As `MujocoMuscles.aim`."""
        self._whole.aim_some(self._at, goal)

    def advance(self, now: float) -> None:
        """The whole body advances; the other buses see it when they do."""
        self._whole.advance(now)
        for name in ("position", "velocity", "current", "pwm"):
            getattr(self, name)[:] = getattr(self._whole, name)[self._at]


def body_of(robot: RobotFile, zeros: Mapping[str, int], *, now: float = 0.0) -> MujocoMuscles:
    """The body of a robot file in its rest pose. `zeros`: ticks at joint angle 0, by joint."""
    motors = [Motor.of(joint, zeros[joint.name]) for joint in robot.joints]
    start = {joint.model_joint: robot.poses["rest"][joint.name] for joint in robot.joints}
    spec = mujoco.MjSpec.from_file(str(Path(robot.mjcf_path)))
    return MujocoMuscles(spec, motors, pinned=robot.support != "free", start=start, now=now)


def _compile(spec: mujoco.MjSpec, motors: Sequence[Motor], *, pinned: bool) -> mujoco.MjModel:
    """The model with our motors instead of its own; sensors and key poses would refer to what is gone."""
    for element in [*spec.actuators, *spec.sensors, *spec.keys]:
        spec.delete(element)
    if pinned:
        for joint in [joint for joint in spec.joints if joint.type == mujoco.mjtJoint.mjJNT_FREE]:
            spec.delete(joint)
    names = {joint.name for joint in spec.joints}
    for motor in motors:
        if motor.joint not in names:
            raise KeyError(f"the model has no joint {motor.joint!r}; it has {', '.join(sorted(names))}")
        actuator = spec.add_actuator(name=motor.joint, target=motor.joint)
        actuator.trntype = mujoco.mjtTrn.mjTRN_JOINT
        actuator.gaintype, actuator.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
        actuator.forcelimited, actuator.forcerange = True, [-1.0, 1.0]
    spec.option.timestep = STEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    return spec.compile()
