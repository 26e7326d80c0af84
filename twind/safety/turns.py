"""Did an actuator wake up on the turn that it was calibrated on? Pure.

An encoder of one turn says less than a position that goes on over several: after power-off the reading may be
a whole turn off, or anywhere where the zero was lost. Of the reading and the two a turn beside it exactly one
must lie in the joint's travel, and that must be the reading; else nobody arms.
"""

from collections.abc import Sequence

import numpy as np

from twind.robot.arrays import Floats
from twind.robot.finding import Code, Finding
from twind.robot.limits import Limits

TOLERANCE = 0.15  # rad beyond the hard limits that a limp joint may hang at
BESIDE = (0, -1, 1)  # turns

_REMEDY = "find out why, move it into its travel by hand with torque off, or calibrate anew"


def astray(position: Floats, turn: Floats, limits: Limits) -> Sequence[Finding]:
    """Joints whose reading (n,) rad cannot be told from one a turn (n,) rad beside it, or fits nowhere.

    `turn`: of the actuator, at the joint; inf: it tells its turn itself, and is not judged. NaN fits nowhere.
    """
    judged = np.flatnonzero(turn < np.inf)
    found = []
    for joint in judged.tolist():
        low, high = float(limits.hard_lower[joint]) - TOLERANCE, float(limits.hard_upper[joint]) + TOLERANCE
        reading, whole = float(position[joint]), float(turn[joint])
        fitting = [beside for beside in BESIDE if low <= reading + beside * whole <= high]
        if fitting != [0]:
            bound = low if reading < low else high
            message = _why(fitting, reading, whole, low, high)
            found.append(Finding(Code.CALIB_MISMATCH, joint, value=reading, bound=bound, message=message))
    return found


def _why(fitting: list[int], reading: float, whole: float, low: float, high: float) -> str:
    travel = f"its travel {low:.3f}..{high:.3f}"
    if not fitting:
        return f"neither {reading:.3f} rad nor a turn beside it is within {travel}: zero lost? {_REMEDY}"
    if len(fitting) > 1:
        both = " and ".join(f"{reading + beside * whole:.3f}" for beside in fitting)
        return f"{both} rad both fit {travel}: nobody can tell which turn it is on; narrow limits_rad"
    right = reading + fitting[0] * whole
    return f"reads {reading:.3f} rad, a turn off: {right:.3f} is within {travel}; {_REMEDY}"
