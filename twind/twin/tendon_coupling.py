"""Shafts of virtual motors that turn joints together, as tendons of the model.

The length of a tendon is a shaft's angle. Runs in `twind-virtual` (and in tests). The force of a motor on its
tendon reaches the joints by J⁻ᵀ, so no power is lost. A tendon is linear in its joints: for a linkage it is
set anew, from the table, before every step.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from twind.robot.arrays import Floats
from twind.robot.transmission import Transmission

PREFIX = "shaft of "  # a joint's slot, in the model


@dataclass(frozen=True)
class MotorGroup:
    """Motors that turn as many joints of the model together; `rows`: their places among all motors."""

    law: Transmission
    rows: tuple[int, ...]
    joints: tuple[str, ...]


def strung(spec: mujoco.MjSpec, groups: Sequence[MotorGroup]) -> None:
    """Add a tendon for every motor of a group, over all its joints."""
    for group in groups:
        for joint in group.joints:
            tendon = spec.add_tendon(name=f"{PREFIX}{joint}")
            for other in group.joints:
                tendon.wrap_joint(other, 1.0)


class Coupling:
    """One group in a compiled model. Arrays are (k,)."""

    def __init__(self, model: mujoco.MjModel, group: MotorGroup) -> None:
        self.rows = np.array(group.rows, np.intp)
        self.tendons = np.array([model.tendon(f"{PREFIX}{joint}").id for joint in group.joints], np.intp)
        self._law = group.law
        self._model = model
        joints = [model.joint(joint) for joint in group.joints]
        self._q = np.array([int(joint.qposadr[0]) for joint in joints], np.intp)
        self._v = np.array([int(joint.dofadr[0]) for joint in joints], np.intp)
        self._wraps = np.array([model.tendon_adr[t] + np.arange(len(joints)) for t in self.tendons])
        self._joints = np.zeros(len(joints))
        self._shafts = np.zeros(len(joints))
        self._back: Floats = np.eye(len(joints))  # dshaft/djoint at the last place
        middle = group.law.places.mean(axis=0)
        self._keep(group.law.forward(middle), middle)

    def place(self, data: mujoco.MjData) -> tuple[Floats, Floats]:
        """Return angles and speeds of the shafts; outside the table, in a straight line from its edge."""
        joints = data.qpos[self._q]
        shafts = self._law.inverse(joints)
        if np.isfinite(shafts).all():
            self._keep(joints, shafts)
        else:
            shafts = self._shafts + self._back @ (joints - self._joints)
        return shafts, self._back @ data.qvel[self._v]

    def set_tendon_positions(self, data: mujoco.MjData, shafts: Floats) -> None:
        """Set the tendons for the present shaft angles (`place`).

        Forces depend on the angle of a shaft, not on the length of its tendon.
        """
        self._model.wrap_prm[self._wraps] = self._back
        length = self._back @ data.qpos[self._q]
        model = self._model
        rows = self.rows
        model.actuator_biasprm[rows, 0] = model.actuator_biasprm[rows, 1] * (shafts - length)

    def to_joints(self, torque: Floats) -> tuple[np.ndarray, Floats]:
        """Return addresses in qvel, and the joint torques there of the shafts' torques."""
        return self._v, self._back.T @ torque

    def _keep(self, joints: Floats, shafts: Floats) -> None:
        self._joints = joints
        self._shafts = shafts
        self._back = np.asarray(np.linalg.inv(self._law.jacobian(shafts)), np.float64)
