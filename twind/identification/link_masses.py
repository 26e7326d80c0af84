"""Masses of links from the loads of joints, where the motion determines them.

Each joint feels a sum of the links behind it; only what such sums determine is reported.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from twind.config.identified_spec import IdentifiedBody, ParameterEstimate
from twind.gap.motion_samples import MotionSamples
from twind.identification.link_weights import SPREAD, link_weights
from twind.identification.robot_fit import model_priors
from twind.twin.binding import Binding

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
    weights = link_weights(binding, motions)
    bodies = weights.bodies
    rows = [place for place, name in enumerate(binding.robot.names) if name in known]
    estimates = [known[binding.robot.names[row]] for row in rows]
    # The joint's own prior is taken out again, so that it does not count twice.
    own = np.array([1.0 / each.prior_sd**2 for each in estimates])
    known_sd = np.array([each.sd for each in estimates])
    found_alone = np.maximum(1.0 / known_sd**2 - own, 1e-9)
    value = np.array([each.value / each.sd**2 - each.prior / each.prior_sd**2 for each in estimates])
    pull = np.array([weights.pull(row, model_priors(binding, row).stall_nm) for row in rows])
    # A cable pulls as weight does: the less weight there is, the less the load says of masses.
    precision = 1.0 / (1.0 / found_alone + pull**2)
    information = value / found_alone * precision
    table = weights.shares[rows]
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
