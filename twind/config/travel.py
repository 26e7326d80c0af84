"""Travel of a joint in counts: does a sweep by hand fit one turn of its encoder?"""

from twind.config.calibration_file import SWEEP_MARGIN
from twind.config.counts import tick_range, turn_start
from twind.config.robot_spec import JointSpec

SEAM = 32  # ticks that the travel keeps from the seam of the encoder


def sweep_range(joint: JointSpec) -> tuple[float, float]:
    """Return the range (rad) of an actuator in a sweep by hand where no stop limits it."""
    lower, upper = joint.span
    return lower - SWEEP_MARGIN, upper + SWEEP_MARGIN


def zero_range(joint: JointSpec) -> tuple[int, int]:
    """Return the smallest and the largest zero that keep a swept joint on one turn, clear of its seam.

    Where no zero does, the first is above the last.
    """
    start = turn_start(joint.type)
    low, high = tick_range(joint, 0, *sweep_range(joint))
    return start + SEAM - low, start + joint.type.ticks_per_turn - 1 - SEAM - high


def travel_refusal(joint: JointSpec) -> str | None:
    """Return why the joint has no zero that fits its travel; None: it has one."""
    first, last = zero_range(joint)
    if first <= last:
        return None
    low, high = tick_range(joint, 0, *sweep_range(joint))
    turn = joint.type.ticks_per_turn
    margins = f"{SWEEP_MARGIN:g} rad on either side for a sweep by hand, and {2 * SEAM} to the seam"
    return f"travel of {high - low} ticks does not fit one turn of {turn} ({margins}): narrow limits_rad"
