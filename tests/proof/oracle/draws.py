"""Random trajectories with limits a hair above or below what they reach, so that the edges are walked."""

from dataclasses import dataclass, replace

import numpy as np

from tests.proof.oracle.dense import excess
from tests.support import gate_rig as w
from twind.robot.finding import ReasonCode
from twind.robot.joint_limits import JointLimits
from twind.robot.trajectory import Reference, Trajectory
from twind.safety.gate import TrajectoryRequest

HAIRS = (1e-1, 1e-2, 1e-4, 1e-6, 1e-8)  # of the value


@dataclass(frozen=True, slots=True)
class Question:
    """Question to both gate and oracle."""

    path: Trajectory
    before: Reference
    limit: JointLimits
    demand: TrajectoryRequest


def question(rng: np.random.Generator) -> Question:
    """One to three joints, one to five points; lines, cubics or quintics; limits that are nearly reached."""
    n = int(rng.integers(1, 4))
    k = int(rng.integers(1, 6))
    degree = int(rng.integers(3))
    time = np.cumsum(rng.choice((0.02, 0.1, 0.3, 1.0)) * rng.uniform(0.1, 2.0, k))
    if rng.random() < 0.4:
        time -= time[0]
    position = rng.choice((0.02, 0.3, 1.0)) * rng.uniform(-1.0, 1.0, (k, n))
    if rng.random() < 0.3:  # a single sweep in one direction
        position = np.sort(position, axis=0)
    rates = [None if degree <= i else rng.choice((0.0, 0.3, 2.0)) * rng.normal(size=(k, n)) for i in range(2)]
    stop = bool(rng.random() < 0.3)
    if rates[0] is not None and rng.random() < 0.6:
        rates[0][-1] = 0.0 if not stop else 0.2 * rates[0][-1]
    commanded = rng.random(n) < 0.8
    commanded[int(rng.integers(n))] = True
    path = Trajectory(time, position, commanded, *rates)
    before = _reference(rng, path)
    policy = "retime" if rng.random() < 0.35 else "reject"
    return Question(path, before, _limits(rng, path, before), TrajectoryRequest(policy, stop))


def _reference(rng: np.random.Generator, path: Trajectory) -> Reference:
    n = path.position.shape[1]
    place = path.position[0] + rng.choice((0.0, 0.01, 0.049, 0.2)) * rng.uniform(-1.0, 1.0, n)
    zeros = np.zeros(n)
    speed = zeros if rng.random() < 0.6 else rng.normal(size=n) * rng.choice((0.1, 1.0))
    return Reference(place, speed, zeros if rng.random() < 0.8 else rng.normal(size=n))


def _limits(rng: np.random.Generator, path: Trajectory, before: Reference) -> JointLimits:
    """Wide limits, of which one rule after another is drawn to where the path just meets or breaks it."""
    n = path.position.shape[1]
    limit = w.limits(n, lower=-9.0, upper=9.0, velocity=1e3, acceleration=1e5)
    if not (path.time > 0.0).any():
        return limit
    for joint in range(n):
        alone = replace(path, commanded=np.arange(n) == joint)
        for code in (
            ReasonCode.VEL_LIMIT,
            ReasonCode.ACC_LIMIT,
            ReasonCode.POS_LIMIT,
            ReasonCode.BRAKE_DISTANCE,
        ):
            if rng.random() < 0.7:
                _tighten(rng, limit, excess(alone, before, limit)[code], code, joint)
    return limit


def _tighten(rng: np.random.Generator, limit: JointLimits, over: float, code: ReasonCode, joint: int) -> None:
    """The bound of one rule, moved to a hair above (mostly) or below what the path reaches."""
    hair = float(rng.choice(HAIRS)) * (1.0 if rng.random() < 0.75 else -1.0)
    if code is ReasonCode.VEL_LIMIT:
        limit.velocity[joint] = max((limit.velocity[joint] + over) * (1.0 + hair), 1e-3)
    elif code is ReasonCode.ACC_LIMIT:
        limit.acceleration[joint] = max((limit.acceleration[joint] + over) * (1.0 + hair), 0.1)
    elif code is ReasonCode.POS_LIMIT:  # from the side that is nearer
        side = limit.upper[joint] + over
        limit.upper[joint] = max(abs(side) * (1.0 + hair), 1e-3)
        limit.lower[joint] = -limit.upper[joint]
        limit.hard_upper[joint] = limit.upper[joint] + 0.05
        limit.hard_lower[joint] = -limit.hard_upper[joint]
    elif rng.random() < 0.5:  # a hard limit at the soft one: braking decides
        limit.hard_upper[joint] = limit.upper[joint] * (1.0 + abs(hair))
        limit.hard_lower[joint] = -limit.hard_upper[joint]
