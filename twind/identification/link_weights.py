"""Weight that links put on joints along a motion, and how well the model knows it."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from twind.gap.motion_samples import MotionSamples
from twind.identification.joint_loads import bare_model, without_holes
from twind.robot.arrays import Floats
from twind.twin.binding import Binding

SPREAD = 0.2  # of a link's mass, as a share of the model's: prior
POSES = 60  # of the motion, at which weight is taken
SPRING = 0.02  # N·m, N·m/rad of cables and springs, as a share of the stall torque
LARGEST = 0.4  # share of the weight, of its uncertainty


@dataclass(frozen=True, slots=True)
class LinkWeights:
    """Weight of b links on n joints."""

    bodies: Sequence[int]  # (b,) of the model
    shares: Floats  # (n, b) of a joint's weight that is a link's
    weight: Floats  # (n,) N·m, rms

    def pull(self, place: int, stall: float) -> float:
        """Return what a cable at joint `place` pulls, as a share of its weight. `stall`: N·m."""
        return SPRING * stall / max(float(self.weight[place]), 1e-9)

    def uncertainty(self, place: int, stall: float) -> float:
        """Return the standard deviation of the load of joint `place`, as a share of its weight."""
        masses = SPREAD * float(np.linalg.norm(self.shares[place]))
        return min(float(np.hypot(masses, self.pull(place, stall))), LARGEST)


def link_weights(binding: Binding, motions: Sequence[MotionSamples]) -> LinkWeights:
    """Return the weights over poses of the motions."""
    bodies = [at for at in range(1, binding.model.nbody) if binding.model.body_mass[at] > 0.0]
    poses = np.concatenate([without_holes(each.position) for each in motions])
    poses = poses[np.linspace(0, len(poses) - 1, POSES).astype(np.int64)]
    model = bare_model(binding)
    data = mujoco.MjData(model)
    masses = model.body_mass.copy()
    torques = np.empty((len(bodies), len(poses), len(binding.dof)))
    for place, body in enumerate(bodies):
        model.body_mass[:] = 0.0
        model.body_mass[body] = masses[body]
        for row, pose in enumerate(poses):
            data.qpos[binding.qpos] = pose
            mujoco.mj_inverse(model, data)
            torques[place, row] = data.qfrc_bias[binding.dof]
    whole = torques.sum(axis=0)
    square = np.einsum("tn,tn->n", whole, whole)
    shares = np.einsum("btn,tn->nb", torques, whole) / np.maximum(square, 1e-12)[:, None]
    found: Floats = np.where(square[:, None] > 1e-10, shares, 0.0)
    return LinkWeights(bodies, found, np.sqrt(square / len(poses)))
