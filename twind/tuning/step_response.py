"""Step of one joint there and back as fast as its limits allow, and the figures of its response. Pure."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twind.exceptions import InvalidInput
from twind.robot.arrays import Floats

SHARE = 0.9  # of the limits of speed and acceleration that a step uses
WATCH = 0.9  # s that the goal stands after each step
TAIL = 0.3  # s at the end, of which the final value is the mean
BAND = 0.05  # share of the step within which a joint is settled
LEAST_BAND = 0.003  # rad: two counts of an encoder
MOVED = 1e-4  # rad: less is no movement of the goal
LEAST_STEP = 0.03  # rad: a smaller step shows the encoder more than the servo


@dataclass(frozen=True, slots=True)
class StepResponse:
    """Figures of a step; times from the first movement of the goal."""

    step: float  # rad
    overshoot: float  # share of the step, beyond the final value
    rise: float  # s from 10 % to 90 % of the way
    settling: float  # s until within 5 % of the step of the final value, for good
    steady_error: float  # rad, goal less final value
    swings: int  # turns farther than that from the final value, after the first arrival
    iae: float  # s, integral of the absolute error divided by the step

    @property
    def rings(self) -> bool:
        """True: it swings back beyond the band, or does not come to rest."""
        return self.swings > 1 or not np.isfinite(self.settling)


def step_motion(start: float, goal: float, velocity: float, acceleration: float) -> tuple[Floats, Floats]:
    """Return positions (4,), rad, and times (4,), s: to `goal`, stand, back to `start`, stand.

    The cubics between points at rest use `SHARE` of the limits (rad/s, rad/s²) given.
    """
    way = abs(goal - start)
    duration = max(1.5 * way / (SHARE * velocity), float(np.sqrt(6.0 * way / (SHARE * acceleration))))
    times = np.cumsum([duration, WATCH, duration, WATCH])
    return np.array([goal, goal, start, start]), times


def measure_steps(time: Floats, goal: Floats, measured: Floats) -> StepResponse:
    """Return the worse figures of both steps of a recorded `step_motion`; arrays (t,), s and rad.

    Raises InvalidInput: the goal did not go there and back, or readings are missing.
    """
    known = np.isfinite(goal) & np.isfinite(measured)
    moving = np.flatnonzero(known[1:] & known[:-1] & (np.abs(np.diff(goal)) > MOVED))
    if len(moving) == 0:
        raise InvalidInput("the goal of the step did not move")
    pauses = np.flatnonzero(np.diff(time[moving]) > 0.5 * WATCH)
    if len(pauses) != 1:
        raise InvalidInput(f"the goal moved {len(pauses) + 1} times, not there and back")
    first = int(moving[0])
    second = int(moving[pauses[0] + 1])
    length = time[second] - time[first]
    parts = [(first, second), (second, int(np.searchsorted(time, time[second] + length)))]
    rows = [slice(begin, end) for begin, end in parts]
    if time[-1] < time[second] + 0.9 * length:
        raise InvalidInput("the recording of the step ends too early")
    return worst([_measure(time[row], goal[row], measured[row]) for row in rows])


def worst(responses: Sequence[StepResponse]) -> StepResponse:
    """Return the largest of each figure; of the step the smallest."""
    return StepResponse(
        step=min(each.step for each in responses),
        overshoot=max(each.overshoot for each in responses),
        rise=max(each.rise for each in responses),
        settling=max(each.settling for each in responses),
        steady_error=max((each.steady_error for each in responses), key=abs),
        swings=max(each.swings for each in responses),
        iae=max(each.iae for each in responses),
    )


def _measure(time: Floats, goal: Floats, measured: Floats) -> StepResponse:
    """Return the figures of one step; it begins with the first row."""
    known = np.isfinite(goal) & np.isfinite(measured)
    at = time[known] - time[0]
    target = goal[known]
    place = measured[known]
    step = float(target[-1] - target[0])
    final = float(place[at > at[-1] - TAIL].mean())
    way = final - float(place[0])
    if abs(way) < 0.3 * abs(step):  # it hardly followed: everything is measured by what it should have done
        way = step
    beyond = (place - final) * np.sign(way)
    band = max(BAND * abs(step), LEAST_BAND)
    share = (place - place[0]) / way
    arrived = np.flatnonzero(share >= 0.9)
    begun = np.flatnonzero(share >= 0.1)
    outside = np.flatnonzero(np.abs(beyond) > band)
    last = int(outside[-1]) + 1 if len(outside) else 0
    resting = last < len(at) and at[last] < at[-1] - 0.5 * TAIL
    sides = np.sign(beyond[outside[outside >= arrived[0]]]) if len(arrived) else np.zeros(0)
    swings = int(np.count_nonzero(np.diff(sides))) + int(len(sides) > 0 and sides[0] > 0)
    return StepResponse(
        step=abs(step),
        overshoot=float(max(beyond.max(), 0.0)) / abs(way),
        rise=float(at[arrived[0]] - at[begun[0]]) if len(arrived) else float("inf"),
        settling=float(at[last]) if resting else float("inf"),
        steady_error=float(target[-1]) - final,
        swings=swings,
        iae=float(np.trapezoid(np.abs(target - place), at)) / abs(step),
    )
