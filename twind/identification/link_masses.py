"""Masses of links from the loads of joints, where the motion determines them.

Each joint feels a sum of the links behind it; only what such sums determine is reported.
"""

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from twind.config.identified_spec import IdentifiedBody, ParameterEstimate
from twind.gap.motion_samples import MotionSamples
from twind.identification.joint_loads import bare_model
from twind.robot.arrays import Floats
from twind.twin.binding import Binding

SPREAD = 0.2  # of a link's mass, as a share of the model's: prior
POSES = 60  # of the motion, at which weight is taken
DETERMINED = 0.75  # share of the prior's deviation that an estimate keeps at most


def link_masses(
    binding: Binding, motions: Sequence[MotionSamples], loads: Mapping[str, ParameterEstimate]
) -> dict[str, IdentifiedBody]:
    """Return the masses of the links that the loads of joints determine, by body.

    `loads`: weight behind each joint, as a share of the model's.
    """
    known = {name: each for name, each in loads.items() if each.determined}
    if not known:
        return {}
    bodies = [at for at in range(1, binding.model.nbody) if binding.model.body_mass[at] > 0.0]
    shares = _weight_shares(binding, motions, bodies)
    rows = [place for place, name in enumerate(binding.robot.names) if name in known]
    estimates = [known[binding.robot.names[row]] for row in rows]
    precision = np.array([1.0 / each.sd**2 - 1.0 / each.prior_sd**2 for each in estimates])
    value = np.array([each.value for each in estimates])
    # The joint's own prior is taken out again, so that it does not count twice.
    information = (value / np.array([each.sd**2 for each in estimates])) - np.array(
        [each.prior / each.prior_sd**2 for each in estimates]
    )
    table = shares[rows]
    curvature = table.T @ (precision[:, None] * table) + np.eye(len(bodies)) / SPREAD**2
    covariance = np.linalg.inv(curvature)
    scale = covariance @ (table.T @ information + np.ones(len(bodies)) / SPREAD**2)
    sd = np.sqrt(np.diag(covariance))
    found = {}
    for at, factor, deviation in zip(bodies, scale.tolist(), sd.tolist(), strict=True):
        if deviation < DETERMINED * SPREAD:
            body = binding.model.body(at)
            mass = float(body.mass[0])
            found[body.name] = IdentifiedBody(
                ParameterEstimate(max(factor, 0.1) * mass, deviation * mass, mass, SPREAD * mass)
            )
    return found


def _weight_shares(binding: Binding, motions: Sequence[MotionSamples], bodies: Sequence[int]) -> Floats:
    """Return by how much of its weight each joint feels each body (n, b), over poses of the motion."""
    poses = np.concatenate([each.position[np.isfinite(each.position).all(axis=1)] for each in motions])
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
    return np.asarray(np.where(square[:, None] > 1e-10, shares, 0.0))
