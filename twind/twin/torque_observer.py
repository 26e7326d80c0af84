"""External torque of each joint: a momentum observer on the identified model. Loop's process.

Inverse dynamics gives the torque of the measured motion; what motors and friction do not explain comes from
outside. A servo that reports no current is taken as its model has it: from its goal, by stiffness, dead band,
damping and limit, at full supply. The observer is a low-pass of first order: in it the differences of
velocity add up to a momentum, so that no second derivative is used. Contacts, stops and loops of the model
are off. Arrays are (n,), in joint order; torque is positive where a hand turns the joint to greater angles.
"""

import copy

import mujoco
import numpy as np

from twind.config.robot_spec import JointSpec
from twind.robot.arrays import Bools, Floats, every
from twind.robot.external_torque import ExternalTorque
from twind.robot.joint_state import JointState
from twind.twin.binding import Binding
from twind.twin.mirror import index
from twind.twin.servo_effects import STRIBECK_SPEED, servo_rows
from twind.twin.simulation import SERVO_FIELDS

TIME = 0.015  # s, time constant: 95 % of a step within 45 ms
MEMORY = 2.0  # s, of the noise of a joint
SLOW = 0.05  # rad/s: two steps of a velocity register; slower, the direction of friction is open
STUCK = 0.7  # of a friction whose direction is open: between even and certain
MODEL = 0.03  # share of the model's torque that identified masses leave open
HALF = 0.5  # share of the correction for goals in steps that is open
LEAST = 0.02  # N·m, standard deviation: a step of a current register and cogging
UNKNOWN = 0.5  # share of a friction, or of the torque by a stiffness, that was not identified
OUTLIER = 3.0  # noise of a joint is measured without values beyond so many deviations
FIRST = 3  # readings after a gap from whose mean the filter begins
LONGEST = 3.5  # periods between two readings, beyond which the difference of velocity tells nothing


def has_observer(binding: Binding) -> bool:
    """Check for an identified model, and for a base that no unknown contact force of feet carries."""
    return binding.robot.identified is not None and not binding.floating


def limbs(binding: Binding) -> list[str]:
    """Return for each joint the body at which its chain leaves the base or a body with several chains."""
    model = binding.model
    branches = np.bincount(model.body_parentid[1:], minlength=model.nbody)
    found = []
    for dof in binding.dof.tolist():
        body = int(model.dof_bodyid[dof])
        while (
            (parent := int(model.body_parentid[body])) and branches[parent] < 2 and model.body_dofnum[parent]
        ):
            body = parent
        found.append(model.body(body).name)
    return found


def observer_of(binding: Binding, period: float) -> "ExternalTorqueObserver | None":
    """Return the observer of a robot; None: no identified model, or feet whose contact forces are unknown."""
    return ExternalTorqueObserver(binding, period) if has_observer(binding) else None


class ExternalTorqueObserver:
    """Observer of one robot; `external` is its estimate after the last reading."""

    def __init__(self, binding: Binding, period: float) -> None:
        """`period`: s, between two readings."""
        self._model = copy.copy(binding.model)
        self._model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        self._data = mujoco.MjData(self._model)
        self._place = index(binding.qpos)
        self._speed = index(binding.dof)
        self._longest = LONGEST * period
        self._gain = 1.0 - float(np.exp(-period / TIME))
        self._forget = period / MEMORY
        modelled = self._model.dof_frictionloss[binding.dof]
        self._dry, dry_sd = _column(binding, "friction_nm", modelled)
        zero = np.zeros(len(modelled))
        self._stribeck, stribeck_sd = _column(binding, "stribeck_nm", zero)
        self._load, _ = _column(binding, "load_friction_per_nm", zero)
        self._loaded = bool(self._load.any())
        # Joints whose servos report no current; their goals act late, but in this model at once.
        self._unmeasured = np.isnan([joint.type.effort_lsb_nm for joint in binding.robot.joints])
        self._modelled = bool(self._unmeasured.any())
        self._goal = index(binding.actuators)
        self._model.actuator_delay[servo_rows(self._model, binding.actuators)] = 0.0
        self._delay, _ = _column(binding, "delay_s", zero)
        self._half_band = 0.5 * _column(binding, "dead_band_rad", zero)[0]
        self._timing = np.where(self._unmeasured, 1.0, HALF)
        self._period = period
        self.take_gains(binding)
        self._variance = dry_sd**2 + stribeck_sd**2 + LEAST**2
        self._torque = zero
        self._count = 0  # readings since a gap
        self._smoothing = 1.0  # variance of the filtered, of that of the raw
        self._noise = np.zeros(len(modelled))  # (N·m)², of the raw residual
        self._last: JointState | None = None
        self._effort = zero  # N·m, of the last reading
        self._sent: Floats | None = None  # the goal before the present one
        self.external: ExternalTorque | None = None

    def take_gains(self, binding: Binding) -> None:
        """Use the servos of `binding`, the same robot with other gains, from now on."""
        for name in SERVO_FIELDS:
            getattr(self._model, name)[:] = getattr(binding.model, name)
        stiffness, deviation = _column(binding, "stiffness_nm_per_rad", binding.ratings.stiffness)
        # A goal is a step of each period. The servo is read just before the next: its torque is then below
        # the mean by what its stiffness makes of half of a step.
        self._stairs = np.nan_to_num(HALF * self._period * stiffness)
        joints = binding.robot.joints
        proportional = (stiffness > 0.0) & ~np.array([_integrates(joint) for joint in joints])
        share = np.divide(deviation, stiffness, out=np.full(len(joints), np.nan), where=proportional)
        self._open = np.where(self._unmeasured, share, 0.0)  # share of the motor's torque
        self._unknown = bool(np.isnan(self._open).any())

    def reset(self) -> None:
        """Begin anew: the next reading follows no other."""
        self._last = self._sent = self.external = None
        self._torque = np.zeros(len(self._dry))
        self._count = 0

    def update(
        self, measured: JointState, *, held: bool, goal: Floats | None = None, limp: Bools | None = None
    ) -> None:
        """Take a reading. `held`: servos follow a goal of each period; `goal` (n,): rad, the one before it.

        `limp` (n,): joints without torque while the others are held; None: none.

        After a gap, or where a joint is silent or its torque unknown, there is no estimate.
        """
        last = self._last
        blind = self._unknown or (self._modelled and not (held and goal is not None))
        if last is measured or blind or not every(measured.heard):
            self.reset()
            return
        self._last = measured
        effort = measured.effort
        before = self._effort
        if self._modelled and goal is not None:
            effort = np.where(self._unmeasured, self._by_servo(measured, goal), effort)
            if limp is not None:
                effort[limp & self._unmeasured] = 0.0
        self._effort = effort
        if last is None:
            return
        elapsed = measured.time - last.time
        if not 0.0 < elapsed <= self._longest:
            self.reset()
            self._last = measured
            return
        needed = self._needed(measured, last, elapsed)
        speed = 0.5 * (measured.velocity + last.velocity)
        motor = 0.5 * (effort + before)
        stairs = self._stairs * speed if held else 0.0
        if limp is not None and held:
            stairs = np.where(limp, 0.0, stairs)
        motor = motor + stairs
        sign = np.tanh(speed / SLOW)
        friction = self._dry + self._stribeck * np.exp(-((speed / STRIBECK_SPEED) ** 2))
        if self._loaded:
            friction += self._load * (np.abs(motor) + np.abs(needed)) ** 2
        off = needed - motor + friction * sign - self._torque
        if not np.isfinite(off.dot(off)):
            self.reset()
            return
        self._count += 1
        gain = max(self._gain, 1.0 / self._count)  # the mean of the readings, until the filter's is less
        self._torque = self._torque + gain * off
        self._smoothing = (1.0 - gain) ** 2 * self._smoothing + gain**2
        open_ = friction * (1.0 - np.abs(sign))  # N·m that static friction may hold either way
        systematic = self._variance + (MODEL * needed) ** 2 + (STUCK * open_) ** 2
        systematic += (self._timing * stairs) ** 2
        if self._modelled:
            systematic += (self._open * motor) ** 2
        squared = np.minimum(off**2, OUTLIER**2 * (self._noise + LEAST**2))
        if self._count > 1:  # the first difference after a gap is the torque itself
            self._noise += self._forget * (squared - self._noise)
        deviation = np.sqrt(systematic + self._smoothing * self._noise)
        self.external = ExternalTorque(self._torque, deviation) if self._count >= FIRST else None

    def _by_servo(self, measured: JointState, goal: Floats) -> Floats:
        """Return the torque (n,) of the model's servos at `goal` (n,), rad."""
        model = self._model
        data = self._data
        speed = 0.0 if self._sent is None else (goal - self._sent) / self._period
        self._sent = goal
        data.qpos[self._place] = measured.position
        data.qvel[self._speed] = measured.velocity
        late = goal - self._delay * speed
        dead = (late - measured.position).clip(-self._half_band, self._half_band)
        data.ctrl[self._goal] = late - dead
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_fwdActuation(model, data)
        torque: Floats = data.qfrc_actuator[self._speed].copy()
        return torque

    def _needed(self, measured: JointState, last: JointState, elapsed: float) -> Floats:
        """Return the torque (n,) between two readings, without friction; valid until the next call."""
        data = self._data
        data.qpos[self._place] = measured.position
        data.qvel[self._speed] = 0.5 * (measured.velocity + last.velocity)
        data.qacc[self._speed] = (measured.velocity - last.velocity) / elapsed
        mujoco.mj_inverse(self._model, data)
        needed: Floats = data.qfrc_inverse[self._speed]
        return needed


def _integrates(joint: JointSpec) -> bool:
    """Check for an integral gain: the torque of such a servo does not follow from its error."""
    return bool(getattr(getattr(joint.type, "gains", None), "i", None))  # each family has gains of its own


def _column(binding: Binding, parameter: str, default: Floats) -> tuple[Floats, Floats]:
    """Return the values of an identified parameter and their standard deviations."""
    value = np.array(default)
    deviation = UNKNOWN * value
    for name, estimate in binding.robot.estimates(parameter).items():
        at = binding.robot.names.index(name)
        value[at] = estimate.value
        deviation[at] = estimate.sd if estimate.determined else UNKNOWN * estimate.value
    return value, deviation
