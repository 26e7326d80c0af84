"""Motion to the rest pose: slow, smooth, and within all limits of the gate (SETTLE)."""

from math import sqrt

import numpy as np

from twind.motion.stop_profiles import require_braking
from twind.robot.arrays import Floats
from twind.robot.joint_limits import JointLimits
from twind.robot.trajectory import Reference, Trajectory

# share of the velocity and acceleration limits, when there is time for it and no other share is requested
SPEED = 0.5
MOST = 0.95  # share of them, when the time is short
BRAKE = 0.98  # of the acceleration limit while a moving reference brakes: rounding stays below the limit
# a move beyond LARGE rad takes LEAST s or more, a smaller one SHORT s
LARGE = 0.1
LEAST = 1.0
SHORT = 0.25
GRID = 0.005  # s: braking joints come to rest on this grid, so that no two points are closer
# a way that brakes too late is stretched until it does not
STRETCH = 1.1
TRIES = 60
# points of the way at which braking is checked, from its middle to CLOSE (share of its time) before the end
SAMPLES = 400
CLOSE = 1e-4
POINTS = 20  # of the way after braking, where cubics stand for the quintic
# rad/s, of the brake rule (BRAKE_DISTANCE): speed <= max(EDGE, sqrt(2 a d) - MARGIN)
EDGE = 0.05
MARGIN = 0.2


def settle(
    reference: Reference,
    rest_position: Floats,
    limits: JointLimits,
    seconds: float = 4.0,
    speed: float = SPEED,
) -> Trajectory:
    """Return the motion from `reference` to rest at `rest_position` (n,), rad.

    It uses the share `speed` of the limits. It is faster when `seconds` require it, and longer than `seconds`
    only where the limits need it. A reference that moves brakes first.

    Raises InvalidInput where a joint cannot brake.
    """
    require_braking(limits.acceleration)
    velocity = np.nan_to_num(reference.velocity, posinf=0.0, neginf=0.0)  # unknown: as if standing
    # s (n,) until each joint rests: whole steps of the grid, none where less is left than rounding
    stops = np.ceil(np.abs(velocity) / (BRAKE * limits.acceleration) / GRID - 1e-9) * GRID
    if not stops.any():
        lasts = _lasts(reference.position, rest_position, limits, seconds, speed)
        zero = np.zeros((1, len(rest_position)))
        return Trajectory(np.array([lasts]), rest_position[None, :].copy(), zero[0] == 0.0, zero, zero)
    return _braking_first(reference.position, velocity, stops, rest_position, limits, seconds, speed)


def _lasts(start: Floats, end: Floats, limits: JointLimits, seconds: float, speed: float) -> float:
    """Return the duration (s) of a quintic from rest to rest, with peaks 1.875 d / T and 5.774 d / T²."""
    distance = np.abs(end - start)

    def least(share: float) -> float:
        by_speed = float((1.875 * distance / (share * limits.velocity)).max(initial=0.0))
        by_force = float((5.7736 * distance / (share * limits.acceleration)).max(initial=0.0))
        return max(by_speed, sqrt(by_force))

    shortest = (LEAST if float(distance.max(initial=0.0)) > LARGE else SHORT) * SPEED / speed
    lasts = max(least(MOST), min(max(shortest, least(speed)), seconds), GRID)
    for _ in range(TRIES):
        if _brakes_in_time(start, end, lasts, limits):
            break
        lasts *= STRETCH
    return lasts


def _way(start: Floats, end: Floats, u: Floats) -> tuple[Floats, Floats]:
    """Return positions and velocities (by u) of the quintic at `u` (k,) in 0..1; (k, n) each."""
    u = u[:, None]
    position = start + (end - start) * u**3 * (10.0 - 15.0 * u + 6.0 * u * u)
    return position, (end - start) * 30.0 * (u * (1.0 - u)) ** 2


def _brakes_in_time(start: Floats, end: Floats, lasts: float, limits: JointLimits) -> bool:
    """Check the brake rule on the way, sampled, towards the limit that each joint moves to.

    The first half has the same speeds as the second one and more room. Samples are the denser the closer
    they are to the end: between two of them the speed changes by less than the margin of `MOST`.
    """
    u = 1.0 - np.geomspace(CLOSE, 0.5, SAMPLES)
    position, speed = _way(start, end, u)
    room = np.where(end >= start, limits.hard_upper - position, position - limits.hard_lower)
    allowed = np.sqrt(2.0 * limits.acceleration * np.maximum(room, 0.0)) - MARGIN
    return bool((np.abs(speed) / lasts <= MOST * np.maximum(EDGE, allowed)).all())


def _braking_first(
    place: Floats,
    velocity: Floats,
    stops: Floats,
    end: Floats,
    limits: JointLimits,
    seconds: float,
    speed: float,
) -> Trajectory:
    """Return the motion of moving joints: each brakes evenly until its instant in `stops`, then the way.

    Braking is exact as cubics between those instants.
    """
    instants = np.unique(stops[stops > 0.0])
    s = np.minimum(instants[:, None], stops)
    share = s / np.maximum(stops, GRID)
    position = place + velocity * s * (1.0 - 0.5 * share)
    start = position[-1]
    braked = float(instants[-1])
    lasts = _lasts(start, end, limits, seconds - braked, speed)
    u = np.linspace(0.0, 1.0, POINTS + 1)[1:]
    way, rate = _way(start, end, u)
    return Trajectory(
        np.concatenate([instants, braked + u * lasts]),
        np.vstack([position, way[:-1], end]),
        np.ones(len(end), np.bool_),
        np.vstack([velocity * (1.0 - share), rate / lasts]),
    )
