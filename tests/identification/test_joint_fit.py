"""Uncertainties of a fit include a weight that is not fitted, and effects that the model lacks."""

import numpy as np

from twind.identification.joint_fit import JointFit, fit_joint
from twind.identification.servo_parameters import FITTED, LOAD, priors_of
from twind.robot.arrays import Bools, Floats

STIFFNESS = FITTED.index("stiffness_nm_per_rad")
DELAY = FITTED.index("delay_s")
WEIGHT = FITTED.index(LOAD)
NOISE = np.random.default_rng(1).normal(0.0, 1e-4, (40, 8))  # rad
PRIORS = priors_of(
    {
        "stiffness_nm_per_rad": 8.0,
        "damping_nm_s_per_rad": 0.4,
        "friction_nm": 0.05,
        "armature_kg_m2": 0.03,
    },
    1.9,
    load_scale=(1.0, 0.2),
)


def fitted(held: Bools, start: Floats) -> JointFit:
    """Fit motion that shows the ratio of weight and stiffness alone, 1.1 times that of the model."""
    motion = np.random.default_rng(0).normal(0.0, 0.05, (40, 8))

    def errors(values: Floats) -> Floats:
        ratio = values[:, WEIGHT] / (values[:, STIFFNESS] / 8.0)
        return np.asarray((ratio[:, None, None] - 1.1) * motion) + NOISE

    return fit_joint(errors, PRIORS, memory=0, start=start, held=held)


def test_a_held_weight_leaves_the_ratio_to_the_stiffness_which_stays_uncertain() -> None:
    alone = fitted(np.array(FITTED) == LOAD, PRIORS.mean)
    assert alone.values[WEIGHT] == 1.0 and not alone.determined[WEIGHT]
    np.testing.assert_allclose(8.0 / alone.values[STIFFNESS], 1.1, rtol=0.01)
    assert alone.determined[STIFFNESS]
    assert alone.sd[STIFFNESS] / alone.values[STIFFNESS] > 0.1


def test_what_an_effect_that_the_model_lacks_would_change_widens_what_it_touches() -> None:
    motion = np.random.default_rng(0).normal(0.0, 0.05, (40, 8))

    def errors(values: Floats) -> Floats:
        stiffness = np.log(values[:, STIFFNESS] / 8.0)[:, None, None]
        later = (values[:, DELAY] - 0.01)[:, None, None]
        return np.asarray(stiffness * motion + later * motion[::-1]) + NOISE

    def disturbed(values: Floats) -> Floats:
        return errors(values) + 0.1 * motion

    plain = fit_joint(errors, PRIORS, memory=0)
    widened = fit_joint(errors, PRIORS, memory=0, disturbed=disturbed)
    np.testing.assert_array_equal(plain.values, widened.values)
    grown = np.sqrt(widened.sd**2 - plain.sd**2)
    np.testing.assert_allclose(grown[STIFFNESS], 0.1 * 8.0, rtol=0.05)
    assert grown[DELAY] < 0.2 * plain.sd[DELAY] + 1e-3
