"""The motors of virtual servos as MuJoCo actuators: effect of firmware modes, gains, caps and goals.

Runs in `twind-virtual` (and in tests). The strength of each motor comes with its drive. An XM430-W350 at 12 V
stalls at 4.1 N·m and runs free at 4.82 rad/s; position gain P makes P / 128 PWM counts per tick of error, 885
counts are the whole supply voltage (e-manual). P 800 so is 18.9 N·m/rad at the shaft and back-EMF 0.85
N·m·s/rad. I and D act once a millisecond (assumed): I / 65536, D / 16. The speed loop makes P / 128 counts
per raw velocity of error and I / 65536 more each millisecond (the manual's conversion coefficient is unknown:
assumed 1). Current follows from output and back-EMF: where it is the goal (mode 0) or capped (mode 5), the
output follows the speed.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from twind.config.robot_spec import JointSpec
from twind.robot.arrays import Bools, Floats
from twind.twin.gear_friction import GearFriction
from twind.twin.motor_drive import MotorDrive
from twind.twin.tendon_coupling import Coupling, MotorGroup

STEP = 0.002  # s
CYCLE = 0.001  # s, of the servo's own loop
# operating modes; 3 and 4 control a position too
CURRENT = 0
VELOCITY = 1
CURRENT_POSITION = 5
PWM = 16
HAND = 30.0  # N·m of a hand at a limp joint: it lifts every limb, and slips at a hard stop
# N·m/rad, N·m·s/rad of that hand: a limb hangs within 0.001 rad of it
GRIP = 5000.0
STEADY = 250.0
Places = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class ServoMotor:
    """One servo at one hinge of the model."""

    joint: str  # of the model
    zero: float  # encoder ticks at joint angle 0
    ticks: float  # per rad of the joint, signed
    ratio: float = 1.0  # shaft turns per joint turn
    speed_lsb: float = 0.229 * 2.0 * math.pi / 60.0  # rad/s of the shaft per raw velocity
    friction: float = math.nan  # N·m of the joint, dry; NaN: the model's, or the least of a gear
    strength: float = 1.0  # share of the figures of its model
    stops: tuple[float, float] | None = None  # rad of the joint, hard; None: the model's range

    @classmethod
    def from_joint(
        cls,
        joint: JointSpec,
        zero: int,
        *,
        friction: float = math.nan,
        strength: float = 1.0,
        stops: tuple[float, float] | None = None,
    ) -> "ServoMotor":
        """Return the motor of a robot file's joint. `zero`: ticks at joint angle 0."""
        kind = joint.type
        return cls(
            joint=joint.model_joint,
            zero=zero,
            ticks=joint.sign * joint.ratio * kind.ticks_per_turn / (2.0 * math.pi),
            ratio=joint.ratio,
            speed_lsb=kind.velocity_lsb_rad_s,
            friction=friction,
            strength=strength,
            stops=stops,
        )


class MotorControlLoops:
    """Control loops of n motors. Torque and speed are those of the driven joint; arrays (n,), as `motors`.

    Motors that drive joints together (`groups`) have a shaft of their own instead.
    """

    def __init__(
        self, model: mujoco.MjModel, motors: Sequence[ServoMotor], groups: Sequence[MotorGroup] = ()
    ) -> None:
        """`model` has one actuator per motor, in their order, and is changed from here on."""
        joints = [model.joint(motor.joint) for motor in motors]
        self.q: Places = np.array([int(joint.qposadr[0]) for joint in joints], np.intp)
        self.v: Places = np.array([int(joint.dofadr[0]) for joint in joints], np.intp)
        self._zero, self._ticks, self._ratio, self._speed_lsb, self._strength = (
            np.array([getattr(motor, name) for motor in motors], np.float64)
            for name in ("zero", "ticks", "ratio", "speed_lsb", "strength")
        )
        self._torque_lsb = np.ones(len(motors))  # N·m of the shaft per raw current
        self._way = np.copysign(1.0, self._ticks)
        self._angle = self._ratio / np.abs(self._ticks)  # rad of the shaft per tick
        self._model = model
        self._couplings = [Coupling(model, group) for group in groups]
        self._tendon = np.full(len(motors), -1, np.intp)
        for each in self._couplings:
            self._tendon[each.rows] = each.tendons
        friction = np.array([motor.friction for motor in motors])
        self._gears = GearFriction(model, self.v, self._tendon, self._ratio, friction)
        model.actuator_gainprm[:, 0] = 0.0
        model.actuator_biasprm[:, :3] = 0.0
        model.actuator_forcerange[:] = 0.0
        model.dof_solimp[self.v, :2] = 0.9999  # stiff friction: the soft default creeps 10 ticks/s
        model.dof_solref[self.v, 0] = 2.0 * STEP
        model.tendon_solimp_fri[:, :2] = 0.9999
        model.tendon_solref_fri[:, 0] = 2.0 * STEP
        fence(model, joints, motors)
        count = len(motors)
        self._hand, self._lead, self._reach = (np.full(count, np.nan) for _ in range(3))  # rad, rad, rad/s
        self._on = np.zeros(count, np.bool_)
        self._gripped: Places = np.zeros(0, np.intp)
        self._loose = np.ones(count)  # 0: the actuator's force is the hand's, not the motor's
        self.integral = np.zeros(count)  # N·m
        self._mode = np.full(count, 3)
        self._ki = np.zeros(count)
        self._emf = np.zeros(count)
        self._full = np.ones(count)
        self._output = np.zeros(count)
        self._floor = np.zeros(count)
        self._ceiling = np.zeros(count)
        self._most = np.zeros(count)
        self._live: Places = np.zeros(0, np.intp)
        self._simple = True  # all motors control a position
        self._each = np.zeros(count, np.bool_)

    @property
    def busy(self) -> bool:
        """True while `step` must be called before every step of the physics."""
        loaded = self._gears.loaded.size > 0
        return self._live.size > 0 or self._gripped.size > 0 or bool(self._couplings) or loaded

    @property
    def on(self) -> Bools:
        """Mask (n,) of the motors with torque."""
        return self._on

    def drive(self, at: Places, drive: MotorDrive) -> None:
        """Set torque, mode, gains and caps of the motors `at`; the others do not change."""
        model = self._model
        ratio = self._ratio[at]
        ticks = np.abs(self._ticks[at])
        mode = np.asarray(drive.mode)
        on = drive.on
        seeks = (mode >= 3) & (mode <= CURRENT_POSITION)
        spins = mode == VELOCITY
        motor = drive.motor
        stall = motor.stall * self._strength[at]
        full = stall / drive.full * ratio * drive.supply  # N·m per count
        raw = ratio / self._speed_lsb[at]  # raw velocity per rad/s
        kp = np.where(on & seeks, drive.p / motor.divisor * ticks, 0.0) * full
        kd = np.select(
            [on & seeks, on & spins], [drive.d / 16.0 * ticks * CYCLE, drive.velocity_p / 128.0 * raw]
        )
        kd = kd * full
        counts = np.where(on & (mode == PWM), full * self._way[at], 0.0)
        output = np.where(on, drive.pwm_cap * full, 0.0)
        self._torque_lsb[at] = motor.torque_constant * drive.ampere
        current = np.where(on, drive.current_cap * self._torque_lsb[at] * ratio, 0.0)
        model.actuator_gainprm[at, 0] = kp + np.where(spins, kd, 0.0) + counts
        model.actuator_biasprm[at, 1] = -kp
        model.actuator_biasprm[at, 2] = -kd
        bound = np.minimum(output, current)
        model.actuator_forcerange[at] = np.stack([-bound, bound], axis=-1)
        self._emf[at] = np.where(on, stall / motor.speed * ratio**2, 0.0)
        self._gears.set(at, motor, self._emf[at])
        ki = np.select([on & seeks, on & spins], [drive.i * ticks, drive.velocity_i * raw])
        self._ki[at] = ki / 65536.0 * full / CYCLE
        self.integral[at] = np.where(self._ki[at] > 0.0, self.integral[at], 0.0)
        self._mode[at] = mode
        self._full[at] = np.maximum(full, 1e-12)
        self._output[at] = output
        self._most[at] = current
        self._floor[at] = -current
        self._ceiling[at] = current
        most = np.where(mode == CURRENT_POSITION, 2.0 * output, output)  # braking adds the back-EMF
        self._each[at] = on & ((self._ki[at] > 0.0) | (mode == CURRENT) | (current < most))
        self._live = np.flatnonzero(self._each)
        self._grasp(at, on)
        self._simple = bool(((self._mode >= 3) & (self._mode <= CURRENT_POSITION)).all())

    def set_goals(self, at: Places, goal: Floats) -> Floats:
        """Set goals of the motors `at` in the units of their modes.

        Return the controls of their actuators.
        """
        angle = (goal - self._zero[at]) / self._ticks[at]
        if self._simple:
            return angle
        mode = self._mode[at]
        way = self._way[at]
        speed = goal * self._speed_lsb[at] * way / self._ratio[at]
        torque = goal * self._torque_lsb[at] * self._ratio[at] * way
        torque = np.clip(torque, -self._most[at], self._most[at])
        wanted = mode == CURRENT
        self._floor[at] = np.where(wanted, torque, self._floor[at])
        self._ceiling[at] = np.where(wanted, torque, self._ceiling[at])
        return np.select([wanted, mode == VELOCITY, mode == PWM], [0.0 * goal, speed, goal], angle)

    def impede(self, at: Places, on: Bools, kp: Floats, kd: Floats, limit: Floats) -> None:
        """Set the gains of motors `at` that are CAN actuators.

        Their torque is kp (position - q) + kd (velocity - v) + torque, within `limit`. SI at the shaft; their
        current loop makes that torque at any back-EMF. Damping acts implicitly. `steer` must follow.
        """
        model = self._model
        ratio = self._ratio[at]
        stiff, damp = (np.where(on, gain * ratio**2, 0.0) for gain in (kp, kd))
        most = np.where(on, limit * ratio, 0.0)
        model.actuator_gainprm[at, 0] = 1.0
        model.actuator_biasprm[at, 1], model.actuator_biasprm[at, 2] = -stiff, -damp
        model.actuator_forcerange[at] = np.stack([-most, most], axis=-1)
        self._emf[at] = 0.0
        self._each[at] = False
        self._gears.brake(at, 0.0)
        self._live = np.flatnonzero(self._each)
        self._grasp(at, on)

    def steer(self, at: Places, position: Floats, velocity: Floats, torque: Floats) -> Floats:
        """Set the command of these motors; return the controls of their actuators, N·m at the joint."""
        turn = self._ratio[at] * self._way[at]  # rad of the shaft per rad of the joint
        stiff, damp = -self._model.actuator_biasprm[at, 1:3].T
        angle = (position - self._zero[at] * self._angle[at]) / turn
        return np.asarray(stiff * angle + damp * velocity / turn + torque * turn)

    def read_shafts(self, data: mujoco.MjData, at: Places) -> tuple[Floats, Floats, Floats]:
        """Return shaft angle (rad, of the bare encoder), speed (rad/s) and torque (N·m)."""
        ratio = self._ratio[at]
        way = self._way[at]
        turned, speed = self._shafts(data)
        angle = self._zero[at] * self._angle[at] + turned[at] * ratio * way
        force = data.actuator_force[at] * self._loose[at]
        return angle, speed[at] * ratio * way, force / ratio * way

    def grip(self, at: Places, place: Floats, speed: Floats) -> None:
        """Move and hold the limp joints of the motors `at` by hands: ticks (NaN: no hand), ticks/s."""
        self._grip(at, (place - self._zero[at]) / self._ticks[at], speed / np.abs(self._ticks[at]))

    def grip_shaft(self, at: Places, place: Floats, speed: Floats) -> None:
        """Move and hold by hands in rad of the shaft, for CAN actuators; `impede` must follow."""
        turn = self._ratio[at] * self._way[at]
        self._grip(at, (place - self._zero[at] * self._angle[at]) / turn, speed / self._ratio[at])

    def _grip(self, at: Places, angle: Floats, speed: Floats) -> None:
        released = at[np.isnan(angle) & ~self._on[at]]
        self._model.actuator_forcerange[released] = 0.0
        self._hand[at] = angle
        self._reach[at] = speed
        self._grasp(at, self._on[at])

    def _grasp(self, at: Places, on: Bools) -> None:
        """Update hands: at a limp joint a hand is a strong, damped actuator in place of the motor."""
        self._on[at] = on
        held = np.isfinite(self._hand) & ~self._on
        self._lead[~held] = np.nan
        self._gripped = np.flatnonzero(held)
        self._loose = np.where(held, 0.0, 1.0)
        model = self._model
        rows = self._gripped
        model.actuator_gainprm[rows, 0] = GRIP
        model.actuator_biasprm[rows, 1], model.actuator_biasprm[rows, 2] = -GRIP, -STEADY
        model.actuator_forcerange[rows] = [-HAND, HAND]

    def _carry(self, data: mujoco.MjData, turned: Floats) -> None:
        """Move the hands one step along their way, from the joints' positions.

        Before a step of the physics.
        """
        at = self._gripped
        here = np.where(np.isnan(self._lead[at]), turned[at], self._lead[at])
        most = self._reach[at] * STEP
        self._lead[at] = here + np.clip(self._hand[at] - here, -most, most)
        data.ctrl[at] = self._lead[at]

    def step(self, data: mujoco.MjData) -> None:
        """Prepare one step of the physics: hands, integral terms, the range that the back-EMF leaves."""
        turned, speeds = self._shafts(data)
        for each in self._couplings:
            each.set_tendon_positions(data, turned[each.rows])
        if self._gripped.size:
            self._carry(data, turned)
        if self._gears.loaded.size:
            self._gears.bear(data, data.actuator_force + self.integral - self._emf * speeds)
        at = self._live
        speed = speeds[at]
        most = self._output[at]
        actual = np.where(self._mode[at] == VELOCITY, speed, turned[at])
        low, high = (
            np.clip(bound[at] + self._emf[at] * speed, -most, most) for bound in (self._floor, self._ceiling)
        )
        grown = self.integral[at] + self._ki[at] * (data.ctrl[at] - actual) * STEP
        self.integral[at] = np.where(self._ki[at] > 0.0, np.clip(grown, low, high), 0.0)
        self._model.actuator_forcerange[at, 0] = low - self.integral[at]
        self._model.actuator_forcerange[at, 1] = high - self.integral[at]
        data.qfrc_applied[self.v] = self.integral
        for each in self._couplings:
            addresses, torque = each.to_joints(self.integral[each.rows])
            data.qfrc_applied[addresses] = torque

    def block(self, at: Places, held: Bools) -> None:
        """Block the joints of the motors `at`, or free them."""
        self._gears.block(at, held)

    def read(self, data: mujoco.MjData) -> tuple[Floats, Floats, Floats, Floats]:
        """Return encoder ticks, raw velocity, raw current, PWM counts (n,)."""
        angle, speed = self._shafts(data)
        output = data.actuator_force * self._loose + self.integral
        return (
            self._zero + angle * self._ticks,
            speed * self._ratio * self._way / self._speed_lsb,
            (output - self._emf * speed) * self._way / (self._ratio * self._torque_lsb),
            output * self._way / self._full,
        )

    def _shafts(self, data: mujoco.MjData) -> tuple[Floats, Floats]:
        """Return angle and speed (n,) of the shafts or joints that the motors drive."""
        angle = data.qpos[self.q]
        speed = data.qvel[self.v]
        for each in self._couplings:
            angle[each.rows], speed[each.rows] = each.place(data)
        return angle, speed


def fence(model: mujoco.MjModel, joints: Sequence[Any], motors: Sequence[ServoMotor]) -> None:
    """Make stops as hard as metal: the soft default yields by degrees where 1 N·m pushes a small limb."""
    for joint, motor in zip(joints, motors, strict=True):
        if motor.stops is not None:
            model.jnt_limited[joint.id] = True
            model.jnt_range[joint.id] = motor.stops
        model.jnt_solref[joint.id, 0] = 2.0 * STEP
        model.jnt_solimp[joint.id, :2] = 0.9999
