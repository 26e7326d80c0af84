"""Figures of the gap: error of a simulated motion against the measured one, in two norms.

`nrmse_spread` divides the error by the spread of the measured motion. `unexplained` divides it by what the
goal alone leaves unexplained: a stiff servo follows its goal whatever the model. Pure.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twind.gap.motion_samples import MotionSamples
from twind.robot.arrays import Bools, Floats

LEAST_MOTION = 0.02  # rad, standard deviation: below it a joint moved too little for a figure
LEAST_SAMPLES = 50  # of a joint, for a figure
LEAST_EFFORT = 0.01  # N·m, spread of the measured effort: below it noise and resolution are all there is
LEAST_UNEXPLAINED = 1e-3  # rad, rms: below it the goal explains the motion as well as an encoder resolves it
LONGEST_DELAY = 0.25  # s, of the goal
QUANTITIES = {"position": "rad", "velocity": "rad/s", "effort": "N·m"}


@dataclass(frozen=True, slots=True)
class GapFigure:
    """Error of one quantity of one joint. None: the denominator is too small to divide by."""

    rms: float  # error, in the quantity's unit
    nrmse_spread: float | None  # rms / standard deviation of the measured quantity
    unexplained: float | None  # rms / rms of (delayed goal - measured)


@dataclass(frozen=True, slots=True)
class JointGap:
    """Figures of one joint. Without any `position` the joint moved too little, or no samples were usable."""

    joint: str
    samples: int
    moved: float  # rad, standard deviation of the measured position; 0 without samples
    delay: float  # s, of the goal: the one of least rms
    position: GapFigure | None = None
    velocity: GapFigure | None = None
    effort: GapFigure | None = None


def joint_gaps(measured: MotionSamples, simulated: MotionSamples) -> list[JointGap]:
    """Return the figures of each joint. `simulated`: the same rows, NaN where nothing was simulated."""
    return [_joint_gap(measured, simulated, joint) for joint in range(len(measured.names))]


def total_gap(gaps: Sequence[JointGap], quantity: str = "position") -> GapFigure | None:
    """Return the figure of all joints that have one: each norm of the root mean squares over joints.

    None: no joint has a figure.
    """
    found: list[GapFigure] = [figure for gap in gaps if (figure := getattr(gap, quantity)) is not None]
    if not found:
        return None
    rms = float(np.sqrt(np.mean([figure.rms**2 for figure in found])))
    return GapFigure(rms, _pooled(found, "nrmse_spread"), _pooled(found, "unexplained"))


def goal_delay(goal: Floats, position: Floats, period: float) -> tuple[int, float]:
    """Return the delay of least rms of (delayed goal - position), in samples, and that rms, rad.

    `goal` and `position` (t,); rows with NaN do not count.
    """
    longest = min(len(goal) - 1, round(LONGEST_DELAY / period)) if len(goal) > 1 else 0
    errors = [_rms(delayed(goal, lag) - position) for lag in range(longest + 1)]
    if np.isnan(errors).all():
        return 0, float("nan")
    best = int(np.nanargmin(errors))
    return best, errors[best]


def delayed(goal: Floats, lag: int) -> Floats:
    """Return `goal` (t,) that comes `lag` samples later; NaN before its first."""
    return np.concatenate([np.full(lag, np.nan), goal[: len(goal) - lag]])


def _joint_gap(measured: MotionSamples, simulated: MotionSamples, joint: int) -> JointGap:
    position = measured.position[:, joint]
    goal = measured.goal[:, joint]
    usable: Bools = np.isfinite(simulated.position[:, joint] - position) & np.isfinite(goal)
    count = int(usable.sum())
    moved = float(np.std(position[usable])) if count else 0.0
    name = measured.names[joint]
    if count < LEAST_SAMPLES or moved < LEAST_MOTION:
        return JointGap(name, count, moved, 0.0)
    lag, behind = goal_delay(goal, np.where(usable, position, np.nan), measured.period)
    speed = _rms(delayed(np.gradient(goal, measured.period), lag) - measured.velocity[:, joint])
    torque = _rms(measured.effort[:, joint])  # a goal alone says nothing of the torque
    return JointGap(
        joint=name,
        samples=count,
        moved=moved,
        delay=lag * measured.period,
        position=_figure(measured.position, simulated.position, joint, LEAST_MOTION, behind),
        velocity=_figure(measured.velocity, simulated.velocity, joint, LEAST_MOTION, speed),
        effort=_figure(measured.effort, simulated.effort, joint, LEAST_EFFORT, torque),
    )


def _figure(measured: Floats, simulated: Floats, joint: int, least: float, behind: float) -> GapFigure | None:
    """Return the figure of one quantity; `behind`: rms that the goal leaves unexplained."""
    error = simulated[:, joint] - measured[:, joint]
    usable = np.isfinite(error)
    if int(usable.sum()) < LEAST_SAMPLES:
        return None
    rms = _rms(error)
    spread = float(np.std(measured[usable, joint]))
    return GapFigure(
        rms=rms,
        nrmse_spread=rms / spread if spread >= least else None,
        unexplained=rms / behind if behind >= LEAST_UNEXPLAINED else None,
    )


def _pooled(found: Sequence[GapFigure], norm: str) -> float | None:
    """Return sqrt(sum of squared errors / sum of squared denominators) of the figures with this norm."""
    known = [(figure.rms, getattr(figure, norm)) for figure in found if getattr(figure, norm)]
    if not known:
        return 0.0 if any(getattr(figure, norm) == 0.0 for figure in found) else None
    rms = np.array([each for each, _ in known])
    denominator = rms / np.array([share for _, share in known])
    return float(np.sqrt(np.sum(rms**2) / np.sum(denominator**2)))


def _rms(values: Floats) -> float:
    """Return the root mean square of the finite values; NaN: there are none."""
    finite = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if len(finite) else float("nan")
