"""The commanded robot: position servos and physics, one period per tick. Uses no measurement."""

import copy

import mujoco
import numpy as np

from twind.robot.arrays import Bools, Floats, Ints, every, frozen, some
from twind.robot.joint_state import JointState
from twind.twin.base_pose import stand
from twind.twin.binding import Binding
from twind.twin.collision_model import strangers
from twind.twin.contacts import Contact, deepest_contact
from twind.twin.imu_model import ImuModel
from twind.twin.mirror import MAX_ANGLE, index
from twind.twin.servo_effects import EncoderPlay, backlash_of, servo_effects, servo_rows

# MuJoCo handles these by a reset to its own default pose, and goes on.
FATAL = (
    mujoco.mjtWarning.mjWARN_BADQPOS,
    mujoco.mjtWarning.mjWARN_BADQVEL,
    mujoco.mjtWarning.mjWARN_BADQACC,
)
# Of the model: what differs with gains, and what the effects of identified servos change at each step.
SERVO_FIELDS = ("actuator_gainprm", "actuator_biasprm", "actuator_forcerange", "dof_frictionloss")


def hush() -> None:
    """Keep MuJoCo from writing MUJOCO_LOG.TXT into the working directory; `MjData.warning` still counts."""
    mujoco.set_mju_user_warning(_discard)


def _discard(message: str) -> None:
    """Drop the text of a warning; its count is used."""


class Simulation:
    """Physics of the whole robot from the rest pose on. Arrays are (n,) in joint order."""

    def __init__(self, binding: Binding, period: float) -> None:
        """`period`: s of physics per `step`; the model's timestep is shortened to divide it."""
        if not 1e-4 <= period <= 1.0:
            raise ValueError(f"a period of {period} s is outside 0.0001..1")
        self.model = copy.copy(binding.model)
        self._substeps = max(1, int(np.ceil(period / self.model.opt.timestep - 1e-9)))
        self.model.opt.timestep = period / self._substeps
        self.data = mujoco.MjData(self.model)
        self.warnings = 0  # of MuJoCo, all kinds
        self.resets = 0  # times the physics diverged and was reset to the last good pose
        self.frozen = False
        self._floating = binding.floating
        self._base = binding.robot.base
        imu = binding.robot.imu
        self._felt = None if imu is None else ImuModel(self.model, self.data, imu.site)
        self._dof = binding.dof
        self._place = index(binding.qpos)
        self._speed = index(binding.dof)
        self._goal = index(binding.actuators)
        self._qpos = self.data.qpos
        self._qvel = self.data.qvel
        self._ctrl = self.data.ctrl
        self._force = self.data.qfrc_actuator
        self._warned = self.data.warning.number
        self._age = np.zeros(len(binding.rest))
        self._fresh = np.ones(len(binding.rest), np.bool_)
        self._age.setflags(write=False)
        self._fresh.setflags(write=False)
        self._period = period
        self._effects = servo_effects(binding, self.model)
        self._backlash = backlash_of(binding)
        self._play: EncoderPlay | None = None
        servos = servo_rows(self.model, binding.actuators)
        self._delayed = [
            (joint, int(servo))
            for joint, servo in enumerate(servos)
            if self.model.actuator_delay[servo] > 0.0
        ]
        self.place(binding.rest)
        self._rest = np.array(self._qpos), np.array(self._ctrl)

    def take_gains(self, binding: Binding) -> None:
        """Use the servos of `binding`, the same robot with other gains, from now on; the state stays."""
        for name in SERVO_FIELDS:
            getattr(self.model, name)[:] = getattr(binding.model, name)
        self._effects = servo_effects(binding, self.model)

    def place(self, position: Floats) -> None:
        """Start anew at `position` (n,), rad, at rest, holding there.

        A joint without a finite angle stays.
        """
        position = np.where(np.abs(position) < MAX_ANGLE, position, self._qpos[self._place])
        self.begin(position, np.zeros(len(position)), position[None])

    def begin(self, position: Floats, velocity: Floats, goals: Floats) -> None:
        """Start anew at `position` and `velocity` (n,), rad, rad/s, as a measured robot would go on.

        `goals` (k, n), rad: of the last k periods, oldest first; the last is held from here on.
        """
        self.frozen = False
        mujoco.mj_resetData(self.model, self.data)
        self._warned[:] = 0
        self._qpos[self._place] = position
        self._qvel[self._speed] = velocity
        self._ctrl[self._goal] = goals[-1]
        self._fill_history(goals)
        if self._backlash is not None:
            self._play = EncoderPlay(self._backlash, position)
        if self._floating:
            stand(self.model, self.data, self._base)
        self._good = (np.array(self._qpos), np.array(self._ctrl))
        self._sound = False

    def halt(self) -> None:
        """Stop at the present pose, which becomes the goal; no goal is taken until `place` or `release`."""
        self._ctrl[self._goal] = self._qpos[self._place]
        self.frozen = True

    def release(self) -> None:
        """Take goals again."""
        self.frozen = False

    def step(self, goal: Floats | None) -> None:
        """Simulate one period. Without a goal (None, or not finite) a joint holds its last."""
        if goal is not None and not self.frozen:
            fit: Bools = np.abs(goal) < MAX_ANGLE
            self._ctrl[self._goal] = goal if every(fit) else np.where(fit, goal, self._ctrl[self._goal])
        if self._effects is None:
            mujoco.mj_step(self.model, self.data, nstep=self._substeps)
        else:
            for _ in range(self._substeps):
                self._effects.apply(self.data)
                mujoco.mj_step(self.model, self.data)
        if some(self._warned):
            self._warning()
        else:
            self._good[0][:], self._good[1][:] = self._qpos, self._ctrl
            self._sound = True

    def state(self, now: float) -> JointState:
        """Return the simulated state as a fresh reading. Effort is the torque of the servos, N·m."""
        position = _reading(self._qpos, self._place)
        return JointState(
            time=now,
            position=position if self._play is None else frozen(self._play.show(position)),
            velocity=_reading(self._qvel, self._speed),
            effort=_reading(self._force, self._speed),
            age=self._age,
            heard=self._fresh,
            imu=None if self._felt is None else self._felt.read_imu(now),
        )

    def contact(self, joint: int) -> Contact | None:
        """Return the deepest contact that keeps `joint` from turning; None: there is none.

        A free-standing robot always touches the ground, so its contacts with the world do not count.
        """
        ignored = strangers(self.model, self._base) if self._floating else frozenset[int]()
        return deepest_contact(self.model, self.data, int(self._dof[joint]), ignored)

    def _fill_history(self, goals: Floats) -> None:
        """Let delayed servos know the goals of the past; after a reset MuJoCo's history is all zeros."""
        step = self.model.opt.timestep
        for joint, servo in self._delayed:
            samples = int(self.model.actuator_history[servo, 0])
            ages = step * np.arange(samples, 0, -1)  # s, of the samples, oldest first
            back = np.ceil(ages / self._period - 1e-9).astype(np.int64)
            values = goals[np.maximum(len(goals) - 1 - back, 0), joint]
            mujoco.mj_initCtrlHistory(self.model, self.data, servo, None, np.ascontiguousarray(values))

    def _warning(self) -> None:
        """Count warnings.

        After a breakdown restore the last good pose, at rest, as MuJoCo went to its default.

        A pose that breaks down before one sound step is not good: then the rest pose is restored.
        """
        self.warnings += int(self._warned.sum())
        broken = any(self._warned[int(kind)] for kind in FATAL)
        self._warned[:] = 0
        if broken:
            self.resets += 1
            mujoco.mj_resetData(self.model, self.data)
            self._qpos[:], self._ctrl[:] = self._good if self._sound else self._rest
            self._fill_history(self._ctrl[self._goal][None])
            self._sound = False


def _reading(values: Floats, where: slice | Ints) -> Floats:
    copied = np.array(values[where])
    copied.setflags(write=False)
    return copied
