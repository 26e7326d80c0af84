"""Check for exchanged servos: by the load of the moved joint, and by the loads of all others. Pure.

A moved joint changes the loads of the joints that it carries and that carry it, which identifies it. Twins
with parallel axes have equal loads; only the loads of their neighbours differ.
"""

from enum import Enum

import numpy as np

from twind.robot.arrays import Bools, Floats
from twind_calibration.proving.sign_proof import apart, misfits


class JointMatch(Enum):
    """Result of the comparison with one other joint whose servo may be here."""

    HERE = "here"  # excluded: with that servo another load would have been measured
    THERE = "there"  # the servos are exchanged: that is what was measured
    UNTOLD = "untold"  # both would have measured the same


def by_own(measured: Floats, right: Floats, exchanged: Floats, slack: float) -> JointMatch:
    """By the joint's own load (k,); families (d, k)."""
    if not np.isfinite(measured.sum()) or apart(right, exchanged) <= 2.0 * slack:
        return JointMatch.UNTOLD
    return _place(measured, right, exchanged, slack)


def by_others(measured: Floats, right: Floats, exchanged: Floats, slack: Floats, others: Bools) -> JointMatch:
    """By how the load of the joints `others` (n,) changed; loads (k, n), slack (n,).

    Whose load does not change says nothing: it may be propped, or stick.
    """
    found = JointMatch.UNTOLD
    for joint in np.flatnonzero(others):
        one, two, three = (_changes(loads[:, joint]) for loads in (measured, right, exchanged))
        speaks = np.sqrt(np.mean(one**2)) > slack[joint]  # False for NaN
        if not speaks or apart(two[None], three[None]) <= 2.0 * slack[joint]:
            continue
        told = _place(one, two[None], three[None], float(slack[joint]))
        if told is JointMatch.THERE:
            return told
        found = told if told is JointMatch.HERE else found
    return found


def _place(measured: Floats, right: Floats, exchanged: Floats, slack: float) -> JointMatch:
    here, there = (bool((misfits(measured, each) <= slack).any()) for each in (right, exchanged))
    return JointMatch.UNTOLD if here == there else JointMatch.HERE if here else JointMatch.THERE


def _changes(loads: Floats) -> Floats:
    """Without what is the same everywhere: what sticks in a joint that stays."""
    return np.asarray(loads - loads.mean())
