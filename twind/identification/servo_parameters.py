"""Parameters of a joint and its servo as the fit sees them, with their priors from the robot's model.

A fit works on unconstrained numbers: the logarithm of a parameter that is always positive, the value in prior
standard deviations of one that may be zero.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from twind.config.identified_spec import PARAMETERS
from twind.robot.arrays import Floats

LOAD = "load_scale"  # weight behind the joint, as a share of the model's; becomes link masses
FITTED = (*PARAMETERS, LOAD)
# Standard deviation of the logarithm: makers' figures of torque, speed and gears differ by so much.
SPREAD = {
    "stiffness_nm_per_rad": 0.25,
    "damping_nm_s_per_rad": 0.5,
    "friction_nm": 0.6,
    "armature_kg_m2": 0.4,
}
# Prior and standard deviation of parameters that may be zero; the first as a share of the stall torque.
STRIBECK = (0.01, 0.015)
ZERO_BASED = {
    "delay_s": (0.010, 0.010),
    "dead_band_rad": (0.002, 0.004),
    "backlash_rad": (0.005, 0.006),
    LOAD: (1.0, 0.4),  # at most, see `LinkWeights`: cables and springs act like weight
}
LOAD_FRICTION = (0.05, 0.1)  # of the stall torque, in friction at a gear loaded with it
SAG = (0.1, 0.1)  # of the supply at stall torque


@dataclass(frozen=True, slots=True)
class ServoPriors:
    """Priors of `FITTED`, in their units, and how the servo saturates. Arrays are (p,)."""

    mean: Floats
    sd: Floats
    logarithmic: Floats  # 1.0: positive, fitted as its logarithm
    saturation_rad: float  # error at which the drive is at its full voltage
    stall_nm: float  # largest torque

    def encode(self, values: Floats) -> Floats:
        """Return values (…, p) as numbers of the fit, in which the prior is standard normal."""
        positive = self.logarithmic > 0.0
        spread = self.sd / self.mean
        ratio = np.log(np.maximum(values, 1e-300) / np.where(positive, self.mean, 1.0))
        return np.where(positive, ratio / spread, (values - self.mean) / self.sd)

    def decode(self, numbers: Floats) -> Floats:
        """Return numbers of the fit (…, p) as values. A parameter that may be zero is never below it."""
        positive = self.logarithmic > 0.0
        grown = self.mean * np.exp(np.where(positive, numbers, 0.0) * self.sd / self.mean)
        return np.where(positive, grown, np.maximum(self.mean + self.sd * numbers, 0.0))

    @property
    def lowest(self) -> Floats:
        """Lower bounds (p,) of the numbers of the fit."""
        return np.where(self.logarithmic > 0.0, -8.0, -self.mean / self.sd)


def priors_of(known: Mapping[str, float], stall_nm: float, **fixed: tuple[float, float]) -> ServoPriors:
    """Return the priors of a servo. `known`: values of the model; `stall_nm`: its largest torque.

    `fixed`: mean and standard deviation of parameters that are known otherwise.
    """
    given: dict[str, tuple[float, float]] = {
        "stribeck_nm": (STRIBECK[0] * stall_nm, STRIBECK[1] * stall_nm),
        "load_friction_per_nm": (LOAD_FRICTION[0] / stall_nm, LOAD_FRICTION[1] / stall_nm),
        "sag_per_nm": (SAG[0] / stall_nm, SAG[1] / stall_nm),
        **ZERO_BASED,
    }
    for name, spread in SPREAD.items():
        mean = known.get(name, 1.0)
        given[name] = (mean, mean * spread)
    given |= fixed
    table = np.array([given[name] for name in FITTED])
    return ServoPriors(
        mean=table[:, 0],
        sd=table[:, 1],
        logarithmic=np.array([float(name in SPREAD) for name in FITTED]),
        saturation_rad=stall_nm / known["stiffness_nm_per_rad"],
        stall_nm=stall_nm,
    )


def interval(name: str, value: float, sd: float) -> tuple[float, float]:
    """Return the 95 % interval of an estimate, symmetric in what the fit works on."""
    if name in SPREAD:
        factor = math.exp(1.96 * sd / max(value, 1e-12))
        return value / factor, value * factor
    return max(value - 1.96 * sd, 0.0), value + 1.96 * sd
