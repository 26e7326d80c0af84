"""Zero errors that a wrong sign causes when the zero was derived from the travel. Pure.

A travel tells no sign. With the wrong one its lower end is taken for the upper, and a zero that came of its
ends fits both as well as the right zero would: it is off by the sum of their angles.
"""

import numpy as np

from twind.config.calibration_file import JointCalibration
from twind.config.counts import angle_of
from twind.config.robot_spec import JointSpec
from twind.robot.arrays import Floats
from twind_calibration.proving.sign_proof import CLOSE, GROSS

Mirror = tuple[float, float]  # rad, least and most that true and told angle add up to
STEP = float(CLOSE[1] - CLOSE[0])  # rad: near enough to each other that loads between them are straight lines


def mirror(joint: JointSpec, entry: JointCalibration | None) -> Mirror:
    """Return the bounds of the sum of true and reported angle for a wrong sign, by the travel (rad).

    Each end of the swept travel lay where the other one is described to be: at a stop, or at a limit where
    the stop is not described. Not calibrated: as if it had been swept from end to end.
    """
    ends = [
        joint.lower if joint.stops.lower is None else joint.stops.lower,
        joint.upper if joint.stops.upper is None else joint.stops.upper,
    ]
    told = ends
    if entry is not None:
        told = sorted(angle_of(joint, entry.zero_ticks, ticks) for ticks in entry.sweep_ticks)
    sums = sorted((ends[0] + told[1], ends[1] + told[0]))
    return sums[0], sums[1]


def offsets(sums: Mirror, step: float = STEP) -> Floats:
    """Return the zero errors (rad, ascending) to try with a wrong sign, to 5 degrees beyond each bound."""
    first = -sums[1] - GROSS
    last = -sums[0] + GROSS
    return np.linspace(first, last, max(2, 1 + int(np.ceil((last - first) / step))))
