"""Motions that make parameters of a joint visible: steps for inertia and friction, chirps for damping, delay
and dead band, slow ramps with reversals for friction near rest and play.

Chirps and ramps pass over many places of the gear, so that none of its irregularities speaks for all.
"""

from dataclasses import dataclass

import numpy as np

from twind.robot.arrays import Floats

RATE = 50.0  # Hz, of the points of a motion
REST = 0.4  # s between the parts
SHARE = 0.85  # of the limits of speed and acceleration that a motion uses
CHIRP = (0.3, 5.0, 6.0)  # Hz, Hz, s
FADE = 1.0  # s
RAMP = 0.08  # rad/s
# Ends of the ramps, as shares of the amplitude.
ZIGZAG = (-0.3, -0.45, -0.15, -0.3, 0.0, -0.15, 0.15, 0.0, 0.3, 0.1)


@dataclass(frozen=True, slots=True)
class ExcitationBounds:
    """Range, speed and acceleration of one joint, all at most."""

    lower: float  # rad
    upper: float  # rad
    velocity: float  # rad/s
    acceleration: float  # rad/s²


def excite(start: float, bounds: ExcitationBounds, amplitude: float, shift: float = 0.0) -> Floats:
    """Return goals (k,), rad, at `RATE`, from `start` around the place nearest to it with room, and back.

    `amplitude`: rad, either way; `shift`: 0..1, phase of the chirp, so that joints move differently.
    """
    reach = min(amplitude, 0.45 * (bounds.upper - bounds.lower))
    middle = float(np.clip(start, bounds.lower + reach, bounds.upper - reach))
    places = [middle, middle + reach, middle - 0.5 * reach, middle + 0.25 * reach, middle - reach, middle]
    parts = [_hold(start)]
    here = start
    for place in places:
        parts += [_move(here, place, bounds), _hold(place)]
        here = place
    for way in (1.0, -1.0):
        chirp = _chirp(0.5 * reach, bounds, shift)
        centre = middle + way * np.linspace(-0.5, 0.5, len(chirp)) * reach
        parts += [_move(here, centre[0], bounds), _hold(centre[0]), centre + chirp, _hold(centre[-1])]
        here = centre[-1]
    for share in ZIGZAG:
        place = middle + share * reach
        parts.append(_ramp(here, place))
        here = place
    parts += [_hold(here), _move(here, start, bounds), _hold(start)]
    return np.concatenate(parts)


def _hold(place: float) -> Floats:
    return np.full(round(REST * RATE), place)


def _move(start: float, end: float, bounds: ExcitationBounds) -> Floats:
    """Return the fastest smooth step (fifth degree) that the bounds allow."""
    way = abs(end - start)
    fast = 1.875 * way / (SHARE * bounds.velocity)
    hard = np.sqrt(5.774 * way / (SHARE * bounds.acceleration))
    count = max(10, int(np.ceil(max(fast, hard) * RATE)))  # of few points, speeds between them are too high
    share = np.arange(1, count + 1) / count
    return start + (end - start) * share**3 * (10.0 - 15.0 * share + 6.0 * share**2)


def _chirp(reach: float, bounds: ExcitationBounds, shift: float) -> Floats:
    """Return oscillations of rising frequency; their amplitude falls where the bounds demand it.

    A corner of the amplitude would be a jump of speed, for which the gate slows the whole motion down.
    """
    low, high, length = CHIRP
    time = np.arange(1, round(length * RATE) + 1) / RATE
    frequency = low * (high / low) ** (time / length)
    phase = 2.0 * np.pi * np.cumsum(frequency) / RATE
    turn = 2.0 * np.pi * frequency
    most = np.minimum(SHARE * bounds.velocity / turn, SHARE * bounds.acceleration / turn**2)
    part = np.minimum(1.0, np.minimum(time, length - time) / FADE)
    fade = part**2 * (3.0 - 2.0 * part)
    amplitude = (reach**-4.0 + (0.8 * most) ** -4.0) ** -0.25  # the smaller of both, without a corner
    chirp: Floats = fade * amplitude * np.sin(phase + 2.0 * np.pi * shift)
    return chirp


def _ramp(start: float, end: float) -> Floats:
    count = max(2, round(abs(end - start) / RAMP * RATE))
    return np.linspace(start, end, count + 1)[1:]
