"""Support of the base of a freely standing body while its legs are limp: a simulated crane, or hands.

Runs in `twind-virtual` (and in tests). A weld to the world, switched on and off; the rest is left to the
legs. Pushes are here too: both are done to a base.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from twind.robot.arrays import Bools, Floats, Ints
from twind.twin.base_pose import stand

WELD = "crane"  # the equality's name, in the model
PATIENCE = 1.0  # s of torque in all legs before it releases the base
BY_TORQUE = "torque"
BY_ORDER = "order"
NEVER = "never"
HOLDS = (BY_TORQUE, BY_ORDER, NEVER)
# N·s, s, s: a push beyond them is a typing error
STRONGEST = 100.0
SHORTEST = 0.002
LONGEST = 2.0


def hang(spec: mujoco.MjSpec, base: str, step: float) -> None:
    """Put the weld into a model with a free base; it is as stiff as `step` (s) of the physics allows."""
    weld = spec.add_equality(name=WELD, type=mujoco.mjtEq.mjEQ_WELD, objtype=mujoco.mjtObj.mjOBJ_BODY)
    weld.name1 = "world"
    weld.name2 = base
    weld.active = False
    weld.solref = [2.0 * step, 1.0]
    weld.solimp[:2] = [0.9999, 0.9999]


@dataclass(frozen=True, slots=True)
class BaseHold:
    """Settings of how a free body is held."""

    base: str  # the body with the free joint
    legs: tuple[int, ...]  # rows of the motors that carry it
    hold: str = BY_TORQUE  # of `HOLDS`: condition on which the support releases and holds


class BaseSupport:
    """Support of the base of one body. The constructor sets the body on the floor."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, how: BaseHold) -> None:
        """The model has been through `hang`. Raises ValueError: `how.hold` is not one of `HOLDS`."""
        if how.hold not in HOLDS:
            raise ValueError(f"hold: {how.hold!r} is none of {', '.join(HOLDS)}")
        self._model = model
        self._data = data
        self._name = how.base
        self._base = int(model.body(how.base).id)
        self._weld = int(model.equality(WELD).id)
        joint = model.joint(int(model.body(how.base).jntadr[0]))
        self._qpos = int(joint.qposadr[0])
        self._dof = int(joint.dofadr[0])
        self._legs: Ints = np.array(how.legs, np.int64)
        self._auto = how.hold == BY_TORQUE
        self._since = np.inf  # s, since when all legs have had torque while the base is held
        self._carried = False  # the legs carry it: they have had torque since the release
        self._pushes = 0  # steps of the physics that a push still lasts
        stand(model, data, how.base)
        self._upright = self.place
        if how.hold != NEVER:
            self._grasp()

    @property
    def is_holding(self) -> bool:
        """True while the base is held."""
        return bool(self._data.eq_active[self._weld])

    @property
    def place(self) -> Floats:
        """Pose of the base: x, y, z (m) in the world, quaternion w x y z. A copy."""
        return np.array(self._data.qpos[self._qpos : self._qpos + 7])

    def truth(self) -> dict[str, object]:
        """Return the true state of the base: held, place (m), w x y z, speeds (m/s, rad/s, world)."""
        velocity = self._data.qvel[self._dof : self._dof + 6]
        turning = self._data.xmat[self._base].reshape(3, 3) @ velocity[3:]
        place = self.place.tolist()
        return {
            "held": self.is_holding,
            "position": place[:3],
            "quaternion": place[3:],
            "velocity": velocity[:3].tolist(),
            "rotation": turning.tolist(),
        }

    def lift(self) -> None:
        """Put the body upright where it began, higher where its limbs are in the way, and hold it there."""
        place = self._data.qpos[self._qpos : self._qpos + 7]
        place[:] = self._upright
        stand(self._model, self._data, self._name)
        place[2] = max(place[2], self._upright[2])
        self._grasp()

    def let_go(self) -> None:
        """Free the base from now on."""
        self._data.eq_active[self._weld] = 0
        self._since = np.inf
        self._carried = False

    def watch(self, on: Bools, now: float) -> None:
        """Release a body whose legs have had torque for `PATIENCE` s, and hold a limp one again.

        `on`: torque of the motors, at `now` (s).
        """
        if not self._auto:
            return
        legs = on[self._legs]
        whole = bool(legs.all())
        if not self.is_holding:
            if self._carried and not legs.any():
                self._grasp()
            self._carried |= whole
        elif not whole:
            self._since = np.inf
        elif now - self._since >= PATIENCE:
            self.let_go()
        else:
            self._since = min(self._since, now)

    def hold(self, on: bool = True) -> None:
        """Lift the body upright to where it began and hold it there, or (False) let it go."""
        self.lift() if on else self.let_go()

    def push(self, forward: float = 0.0, left: float = 0.0, up: float = 0.0, seconds: float = 0.1) -> None:
        """Push the base at its origin: N·s forward, left, up as it stands now, over `seconds`.

        Raises ValueError beyond 100 N·s and 0.002..2 s.
        """
        impulse = np.array([forward, left, up])
        strength = float(np.linalg.norm(impulse))
        if not (strength <= STRONGEST and SHORTEST <= seconds <= LONGEST):
            bounds = f"0..{STRONGEST:g} N·s over {SHORTEST:g}..{LONGEST:g} s"
            raise ValueError(f"push: {strength:g} N·s over {seconds:g} s is outside {bounds}")
        self._pushes = round(seconds / self._model.opt.timestep)
        turned = self._data.xmat[self._base].reshape(3, 3)
        force = turned @ impulse / (self._pushes * self._model.opt.timestep)
        self._data.xfrc_applied[self._base, :3] = force

    @property
    def pushing(self) -> bool:
        """True while `stepped` must be called after every step of the physics."""
        return self._pushes > 0

    def stepped(self) -> None:
        """Note one step of the physics, and end a push that is over."""
        self._pushes -= 1
        if self._pushes == 0:
            self._data.xfrc_applied[self._base, :3] = 0.0

    def _grasp(self) -> None:
        """Hold the base at its present position, at rest."""
        data = self._data
        mujoco.mj_kinematics(self._model, data)
        data.qvel[self._dof : self._dof + 6] = 0.0
        row = self._model.eq_data[self._weld]
        row[:3], row[3:6] = 0.0, data.xpos[self._base]
        row[6:10], row[10] = data.xquat[self._base], 1.0
        data.eq_active[self._weld] = 1
        self._since = np.inf
        self._carried = False
