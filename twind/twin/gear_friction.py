"""Gears of virtual motors: dry friction, damping and inertia at the joints or shafts that they drive.

Runs in `twind-virtual` (and in tests). A joint's own friction and damping in the model are the gear's: the
larger of both counts. Some gears rub more under load: dry friction grows with the square of the torque that
they carry. Motor and load press the teeth together, so where one holds the other both count.
"""

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from twind.robot.arrays import Bools, Floats
from twind.twin.motor_drive import Strength

BLOCKED = 1e4  # N·m, the friction of a blocked joint
# N·m, N·m·s/rad of a gear before its first drive
FRICTION = 0.05
DAMPING = 0.01
OF_JOINT = int(mujoco.mjtConstraint.mjCNSTR_FRICTION_DOF)  # the enumeration itself compares slowly
Places = NDArray[np.intp]


def outside_torque(
    model: mujoco.MjModel, data: mujoco.MjData, dofs: slice | NDArray[np.integer[Any]]
) -> Floats:
    """Return the torque (N·m) on joints `dofs` from outside their gears: weight, motion, stops, contacts."""
    first = data.ne
    rows = slice(first, first + data.nf)
    rubbing = np.zeros(model.nv)
    kind = data.efc_type[rows] == OF_JOINT
    rubbing[data.efc_id[rows][kind]] = data.efc_force[rows][kind]
    found: Floats = (data.qfrc_constraint - rubbing - data.qfrc_bias)[dofs]
    return found


class GearFriction:
    """Gears of n motors. Arrays are (n,), torque and speed those of the driven joint."""

    def __init__(
        self, model: mujoco.MjModel, dofs: Places, tendons: Places, ratio: Floats, friction: Floats
    ) -> None:
        """`dofs`: of the joints; `tendons`: of motors that drive joints together, else -1.

        `friction`: N·m, known to be the joint's; NaN: the model's or the gear's.
        """
        self._model = model
        self._dofs = dofs
        self._tendons = tendons
        self._ratio = ratio
        self._known = friction
        direct = tendons < 0
        self._rubbed = np.where(direct, model.dof_frictionloss[dofs], 0.0)
        self._damped = np.where(direct, model.dof_damping[dofs], 0.0)
        self._inertia = np.where(direct, model.dof_armature[dofs], 0.0)
        self._blocked = np.zeros(len(dofs), np.bool_)
        self._dry = np.where(np.isnan(friction), np.maximum(self._rubbed, FRICTION), friction)
        self._wet = np.maximum(self._damped, DAMPING)
        self._load = np.zeros(len(dofs))
        self.loaded: Places = np.zeros(0, np.intp)  # motors whose friction follows the load
        everyone = np.arange(len(dofs))
        self._damp(everyone, self._wet)
        self._rub(everyone, self._dry)

    def set(self, at: Places, motor: Strength, back_emf: Floats) -> None:
        """Set gears and back-EMF (N·m·s/rad) of the motors `at`."""
        ratio = self._ratio[at]
        own = np.maximum(self._rubbed[at], motor.friction * ratio)
        self._dry[at] = np.where(np.isnan(self._known[at]), own, self._known[at])
        self._wet[at] = np.maximum(self._damped[at], motor.damping * ratio**2)
        self._load[at] = np.where(self._tendons[at] < 0, motor.load_friction / ratio, 0.0)
        self.loaded = np.flatnonzero(self._load)
        self._weigh(at, np.maximum(self._inertia[at], motor.armature * ratio**2))
        self.brake(at, back_emf)
        self._rub(at, self._dry[at])

    def brake(self, at: Places, back_emf: Floats | float) -> None:
        """Set the back-EMF of the motors `at`, N·m·s/rad."""
        self._damp(at, self._wet[at] + back_emf)

    def block(self, at: Places, held: Bools) -> None:
        """Block the joints of the motors `at`, or free them."""
        self._blocked[at] = held
        self._rub(at, self._dry[at])

    def bear(self, data: mujoco.MjData, torque: Floats) -> None:
        """Let the friction of loaded gears follow what they carry. `torque` (n,): N·m of the motors."""
        at = self.loaded
        outside = outside_torque(self._model, data, self._dofs[at])
        self._rub(at, self._dry[at] + self._load[at] * (torque[at] - outside) ** 2)

    def _weigh(self, at: Places, armature: Floats) -> None:
        """Set the inertia of the motors at their joints; what MuJoCo derives from it follows."""
        model = self._model
        direct = self._tendons[at] < 0
        dofs = self._dofs[at[direct]]
        if not np.array_equal(model.dof_armature[dofs], armature[direct]):
            model.dof_armature[dofs] = armature[direct]
            mujoco.mj_setConst(model, mujoco.MjData(model))

    def _damp(self, at: Places, damping: Floats) -> None:
        tendon = self._tendons[at]
        self._model.dof_damping[self._dofs[at[tendon < 0]]] = damping[tendon < 0]
        self._model.tendon_damping[tendon[tendon >= 0]] = damping[tendon >= 0]

    def _rub(self, at: Places, friction: Floats) -> None:
        friction = np.where(self._blocked[at], BLOCKED, friction)
        tendon = self._tendons[at]
        self._model.dof_frictionloss[self._dofs[at[tendon < 0]]] = friction[tendon < 0]
        self._model.tendon_frictionloss[tendon[tendon >= 0]] = friction[tendon >= 0]
