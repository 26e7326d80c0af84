"""Travel of a joint in counts: does a sweep by hand fit the turns of its encoder?

An actuator that reads one turn after a power-up, but takes goals beyond it, may travel as far as its goals
reach. `twind/safety/multiturn.py` determines its turn.
"""

from math import isfinite

from twind.config.actuator_types import TypeSpec
from twind.config.calibration_file import SWEEP_MARGIN
from twind.config.counts import rad_per_tick, tick_range, turn_start
from twind.config.device_check import PLAUSIBLE_SWEEP
from twind.config.robot_spec import JointSpec
from twind.robot.measured_travel import ROOM

SEAM = 32  # ticks that the travel keeps from the seam of the encoder
ASTRAY = 0.15  # rad, how far a limp joint may hang beyond its travel


def most_turns(kind: TypeSpec, mode: str) -> float:
    """Return the turns that limits of a joint may span in that mode of its actuator.

    It may start on any turn of its travel, so its goals must reach as far on either side of the first turn.
    """
    if not kind.winds or kind.fenced(mode):
        return 1.0
    least, most = kind.goals(mode, None)
    return max(1.0, ((most - least) / kind.ticks_per_turn - 1.0) // 2.0)


def has_middle(joint: JointSpec) -> bool:
    """Return whether only one turn fits in the middle of the travel of a swept joint."""
    low, high = tick_range(joint, 0, *sweep_range(joint))
    return high - low < 2 * (joint.type.ticks_per_turn - max(slack(joint), joint.type.ticks_per_turn // ROOM))


def sweep_range(joint: JointSpec) -> tuple[float, float]:
    """Return the range (rad) of an actuator in a sweep by hand where no stop limits it."""
    lower, upper = joint.span
    return lower - SWEEP_MARGIN, upper + SWEEP_MARGIN


def range_to_stops(joint: JointSpec, stops: tuple[float, float]) -> tuple[float, float]:
    """Return the range (rad) of an actuator in a sweep by hand from stop to stop; infinite: no stop there.

    It is no smaller than `sweep_range`, and just that where stop to stop does not fit one turn, or is so
    much wider than described that a calibration of it would be doubted.
    """
    usual = sweep_range(joint)
    reach = tuple(stop if isfinite(stop) else own for stop, own in zip(stops, usual, strict=True))
    lower, upper = min(reach[0], usual[0]), max(reach[1], usual[1])
    low, high = tick_range(joint, 0, lower, upper)
    fits = high - low < joint.type.ticks_per_turn - 2 * max(SEAM, slack(joint))
    plausible = upper - lower <= PLAUSIBLE_SWEEP[1] * joint.reach
    return (lower, upper) if fits and plausible else usual


def longest_travel(joint: JointSpec) -> int:
    """Return the longest measured travel (ticks) that the actuator can be sent through."""
    turn = joint.type.ticks_per_turn
    turns = most_turns(joint.type, joint.mode)
    return turn - 1 if turns <= 1.0 else int(turns * turn)


def slack(joint: JointSpec) -> int:
    """Return the ticks that a limp joint may hang beyond its travel."""
    return round(ASTRAY / abs(rad_per_tick(joint)))


def zero_range(joint: JointSpec, by_hand: tuple[float, float] | None = None) -> tuple[int, int]:
    """Return the smallest and the largest zero that suit the travel of a swept joint.

    They keep it on one turn, clear of the seam. Of a longer travel they keep the middle on that turn.
    Where no zero does, the first is above the last. `by_hand`: its range, rad; None: `sweep_range`.
    """
    start = turn_start(joint.type)
    turn = joint.type.ticks_per_turn
    low, high = tick_range(joint, 0, *(by_hand or sweep_range(joint)))
    if is_long(joint):
        low = high = (low + high) // 2
    return start + SEAM - low, start + turn - 1 - SEAM - high


def travel_refusal(joint: JointSpec) -> str | None:
    """Return why the joint has no zero that fits its travel; None: it has one."""
    low, high = tick_range(joint, 0, *sweep_range(joint))
    turn = joint.type.ticks_per_turn
    if is_long(joint):
        if high - low <= longest_travel(joint):
            return None
        return (
            f"travel of {high - low} ticks with a sweep by hand exceeds {longest_travel(joint)}, which its "
            "goals reach on every turn that it may start on: narrow limits_rad"
        )
    first, last = zero_range(joint)
    if first <= last:
        return None
    margins = f"{SWEEP_MARGIN:g} rad on either side for a sweep by hand, and {2 * SEAM} to the seam"
    return f"travel of {high - low} ticks does not fit one turn of {turn} ({margins}): narrow limits_rad"


def is_long(joint: JointSpec) -> bool:
    """Return whether a swept joint leaves one turn of its actuator, and may do so."""
    low, high = tick_range(joint, 0, *sweep_range(joint))
    one_turn = high - low <= joint.type.ticks_per_turn - 1 - 2 * SEAM
    return not one_turn and most_turns(joint.type, joint.mode) > 1.0
