"""Comparison of a travel with the robot file. Pure. The verdict lists likely causes as text."""

from collections.abc import Sequence
from dataclasses import dataclass

from twind.config.device_check import PLAUSIBLE_SWEEP
from twind.config.travel import longest_travel
from twind_calibration.calibrating.calibration_actuators import CalibrationActuator

LIKE = 0.10  # share by which a travel may differ from another joint's and still be taken for it
GUESSES = (0.25, 1 / 3, 0.5, 2.0, 3.0, 4.0)  # what a ratio is often wrong by
LEAST = 0.2  # rad: travel of a joint whose limits nobody knows
NAMED = 3  # joints that are named as the one it may be


@dataclass(frozen=True, slots=True)
class TravelVerdict:
    """Comparison of a measured travel with the described one."""

    radians: float  # at the joint
    share: float  # of the described range
    wrong: str = ""  # what speaks against it; "": nothing
    causes: tuple[str, ...] = ()  # likely ones, the nearest first
    wide: bool = False  # too long, and nothing else: `--wide` takes it

    @property
    def is_acceptable(self) -> bool:
        """True when the travel is acceptable."""
        return not self.wrong


def judge(slot: CalibrationActuator, span: int, others: Sequence[CalibrationActuator] = ()) -> TravelVerdict:
    """Compare a travel of `span` ticks with the described range.

    `others`: the joints that the actuator may be confused with.
    """
    radians = span * abs(slot.rad_per_tick)
    share = radians / slot.range
    low, high = (LEAST / slot.range, PLAUSIBLE_SWEEP[1]) if slot.is_open else PLAUSIBLE_SWEEP
    most = longest_travel(slot.joint)
    if span > most:
        turn = slot.joint.type.ticks_per_turn
        wrong = (
            f"{span / turn:.2f} turns of its actuator, more than {most / turn:.2f}, which its goals reach "
            "after any power-up"
        )
        slips = ("a horn or coupling that slips", "a joint without stops: give it some within its limits")
        return TravelVerdict(radians, share, wrong, (*slips, *_causes(slot, radians, share, others)))
    if not low <= share <= high:
        bound = f"less than {100 * low:.0f}" if not share >= low else f"more than {100 * high:.0f}"
        wrong = f"{100 * share:.0f} % of the described {slot.range:.2f} rad, {bound} %"
        causes = _causes(slot, radians, share, others)
        return TravelVerdict(radians, share, wrong, causes, wide=share > high)
    return TravelVerdict(radians, share)


def _causes(
    slot: CalibrationActuator, radians: float, share: float, others: Sequence[CalibrationActuator]
) -> tuple[str, ...]:
    found = []
    if share < PLAUSIBLE_SWEEP[0]:
        found.append("it was not moved to both its ends")
    for guess in GUESSES:
        if abs(share / guess - 1.0) <= LIKE:
            found.append(f"its ratio: {slot.joint.ratio * guess:g} instead of {slot.joint.ratio:g} would fit")
    like = [other.name for other in others if other.name != slot.name and _like(slot, radians, other)]
    if like:
        more = "" if len(like) <= NAMED else f" or {len(like) - NAMED} more"
        found.append(f"the wrong joint: it goes as far as {', '.join(like[:NAMED])}{more} should")
    found.append(f"limits_rad of {slot.joint.name} are not those of this robot")
    return tuple(found)


def _like(slot: CalibrationActuator, radians: float, other: CalibrationActuator) -> bool:
    """Return whether the travel matches the described range of the other joint."""
    there = radians * slot.joint.ratio / other.joint.ratio
    return abs(there / other.range - 1.0) <= LIKE


@dataclass(frozen=True, slots=True)
class UnexpectedMotion:
    """Motion of joints that were not requested, while a requested joint stood still."""

    asked: tuple[str, ...]
    moved: tuple[str, ...]

    def __str__(self) -> str:
        return (
            f"{' and '.join(self.moved)} moved while {' and '.join(self.asked)}, asked for, did not: are "
            "their ids swapped, or was the other joint moved?"
        )


# shares of the described range
UNMOVED = 0.05
MOVED = 0.30


def find_unexpected_motion(shares: dict[str, float], asked: Sequence[str]) -> UnexpectedMotion | None:
    """Detect motion of the wrong joints; None: there is none.

    `shares`: the share of its range that each actuator has moved. The joints of a limp robot follow each
    other by their weight. Only joints that moved far while a requested joint stood still are reported.
    """
    still = tuple(name for name in asked if shares.get(name, 0.0) < UNMOVED)
    moved = tuple(name for name, share in shares.items() if name not in asked and share >= MOVED)
    return UnexpectedMotion(still, moved) if still and moved else None
