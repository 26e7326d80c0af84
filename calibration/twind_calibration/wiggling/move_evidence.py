"""Evaluation of a small move: encoder and load. Pure.

An encoder shows whether the servo with this id goes where it is sent, and how far. It cannot show sign, gear
ratio or which joint it sits at: goal and reading pass through the same numbers, so what is wrong in them
cancels. The load shows sign and joint where the model says that it must (`load`); the rest is for the eye.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from twind.robot.arrays import Floats
from twind_calibration.wiggling.state_trace import MoveHolds

FOLLOWS = (0.7, 1.3)  # of what the twin does: stiction and a soft gain take some of it
STILL = 0.2  # less than that is no motion
WITH_IT = 0.25  # of the move: another joint that goes that far has moved with it
COUNTS = 0.0046  # rad, three counts of 4096: less than that is nothing
UNSURE = 0.4  # of a load: published torques per ampere of one servo (XM430-W350) differ by so much
MOST_OFF = 0.3  # of the move: so far from home it has not come back


class EncoderResponse(StrEnum):
    """Response of the encoder of the moved joint."""

    FOLLOWS = "follows"
    SHORT = "short"  # less far than the twin
    STILL = "still"
    BACKWARDS = "backwards"
    FAR = "far"
    UNHEARD = "unheard"
    ENDED = "ended"  # something ended the move on the way: nothing is known
    SIMULATED = "simulated"  # nothing of a robot was moved


class TorqueResponse(StrEnum):
    """Agreement of the measured torque with that of the model."""

    AGREES = "agrees"
    REVERSED = "reversed"  # it fits the joint with the other sign
    NEITHER = "neither"  # it fits neither
    UNOBSERVABLE = "unobservable"  # here both signs would feel the same
    UNKNOWN = "unknown"  # no torque is measured, or no model is at hand


@dataclass(frozen=True, slots=True)
class EncoderObservation:
    """Encoder readings. Angles in rad, from the stay before to the far end."""

    motion: EncoderResponse
    asked: float
    expected: float  # by the twin
    moved: float
    off: float  # how far from where it was, at the end
    others: tuple[int, ...] = ()  # joints that moved with it
    ways: tuple[float, ...] = ()  # how far each of them


@dataclass(frozen=True, slots=True)
class TorqueObservation:
    """Load readings. N·m, of the joint, mean of both stays."""

    load: TorqueResponse
    measured: float
    model: float
    reversed: float  # what would be measured with the sign wrong
    like: tuple[int, ...] = ()  # joints at which a servo that measures this might sit instead


def answer(stays: MoveHolds | None, joint: int, asked: float) -> EncoderObservation:
    """Evaluate the encoders for a joint that was sent `asked` (rad) away and back.

    `stays` None: the trace has no such move.
    """
    nothing = EncoderObservation(EncoderResponse.UNHEARD, asked, asked, float("nan"), float("nan"))
    if stays is None:
        return nothing
    moved = stays.out.position - stays.before.position
    twin = stays.out.simulated - stays.before.simulated
    off = float(stays.home.position[joint] - stays.before.position[joint])
    if not np.isfinite(moved[joint] + off):
        return nothing
    expected = float(twin[joint])
    if not abs(expected - asked) <= 0.5 * abs(asked):  # a twin that does not do it is no measure, nor is NaN
        expected = asked
    least = max(WITH_IT * abs(asked), COUNTS)
    with_it = np.abs(moved - np.nan_to_num(twin)) > least  # False for NaN
    with_it[joint] = False
    others = np.flatnonzero(with_it)
    return EncoderObservation(
        motion=_motion(float(moved[joint]) / expected),
        asked=asked,
        expected=expected,
        moved=float(moved[joint]),
        off=off,
        others=tuple(others.tolist()),
        ways=tuple(moved[others].tolist()),
    )


def _motion(share: float) -> EncoderResponse:
    if share < -STILL:
        return EncoderResponse.BACKWARDS
    if share < STILL:
        return EncoderResponse.STILL
    if share < FOLLOWS[0]:
        return EncoderResponse.SHORT
    return EncoderResponse.FOLLOWS if share <= FOLLOWS[1] else EncoderResponse.FAR


def came_back(seen: EncoderObservation) -> bool:
    """Return whether it is back at its first position."""
    return abs(seen.off) <= max(MOST_OFF * abs(seen.asked), COUNTS)


def weigh(measured: float, model: float, reversed: float, friction: float) -> TorqueObservation:
    """The load against both signs; `friction` (N·m) is what a servo's own may add or take.

    Either may also be off by what is not known of a servo's torque. Where the two signs differ by less than
    twice that, the sign cannot be told. NaN: unknown.
    """

    def make_observation(load: TorqueResponse) -> TorqueObservation:
        return TorqueObservation(load, measured, model, reversed)

    if not np.isfinite(measured + model + reversed):
        return make_observation(TorqueResponse.UNKNOWN)
    slack = max(friction, UNSURE * max(abs(model), abs(reversed)))
    fits = abs(measured - model) <= slack
    fits_reversed = abs(measured - reversed) <= slack
    if not abs(model - reversed) > 2.0 * slack:
        return make_observation(
            TorqueResponse.UNOBSERVABLE if fits or fits_reversed else TorqueResponse.NEITHER
        )
    if fits:
        return make_observation(TorqueResponse.AGREES)
    return make_observation(TorqueResponse.REVERSED if fits_reversed else TorqueResponse.NEITHER)


def alike(measured: float, model: float, alternative: Sequence[float], friction: float) -> tuple[int, ...]:
    """Places in `alternative` (N·m, its measurement at other joints) that fit, where its own does not."""
    if not (abs(measured - model) > friction and abs(measured) > 2.0 * friction):  # next to nothing fits many
        return ()
    found: Floats = np.asarray(alternative, np.float64)
    fits = (np.abs(found - measured) <= friction) & (np.abs(found - model) > 2.0 * friction)
    return tuple(np.flatnonzero(fits).tolist())
