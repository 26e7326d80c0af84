"""Masses of links from the loads of joints, where the motion determines them.

Each joint feels a sum of the links behind it; only what such sums determine is reported.
"""

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from twind.config.identified_spec import IdentifiedBody, ParameterEstimate
from twind.gap.motion_samples import MotionSamples
from twind.identification.joint_loads import bare_model
from twind.identification.robot_fit import model_priors
from twind.identification.servo_parameters import FITTED
from twind.robot.arrays import Floats
from twind.twin.binding import Binding

SPREAD = 0.2  # of a link's mass, as a share of the model's: prior
POSES = 60  # of the motion, at which weight is taken
SPRING = 0.02  # N·m of cables and springs that act like weight, as a share of the stall torque
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
    shares, weight = _weight_shares(binding, motions, bodies)
    rows = [place for place, name in enumerate(binding.robot.names) if name in known]
    estimates = [known[binding.robot.names[row]] for row in rows]
    # The joint's own prior is taken out again, so that it does not count twice.
    own = np.array([1.0 / each.prior_sd**2 for each in estimates])
    known_sd = np.array([each.sd for each in estimates])
    found_alone = np.maximum(1.0 / known_sd**2 - own, 1e-9)
    value = np.array([each.value / each.sd**2 - each.prior / each.prior_sd**2 for each in estimates])
    pull = SPRING * np.array([_stall(binding, row) for row in rows])
    # A cable pulls as weight does: the less weight there is, the less the load says of masses.
    precision = 1.0 / (1.0 / found_alone + (pull / np.maximum(weight[rows], 1e-9)) ** 2)
    information = value / found_alone * precision
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


def _stall(binding: Binding, row: int) -> float:
    priors = model_priors(binding, row)
    return float(priors.mean[FITTED.index("stiffness_nm_per_rad")] * priors.saturation_rad)


def _weight_shares(
    binding: Binding, motions: Sequence[MotionSamples], bodies: Sequence[int]
) -> tuple[Floats, Floats]:
    """Return by how much of its weight each joint feels each body (n, b), over poses of the motion.

    Second, the weight itself (n,), N·m, rms.
    """
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
    found: Floats = np.where(square[:, None] > 1e-10, shares, 0.0)
    return found, np.sqrt(square / len(poses))
