"""Rig of the executor's tests: a robot of two joints that holds, and short ways to move it."""

from math import nan

import numpy as np

from tests.support.gate_rig import limits, path
from twind.motion.trajectory_executor import TrajectoryExecutor
from twind.robot.joint_state import JointState
from twind.robot.trajectory import Reference, Trajectory

PERIOD = 0.01
LIMITS = limits(2)


def holding(position: list[float] | None = None) -> TrajectoryExecutor:
    executor = TrajectoryExecutor(LIMITS, PERIOD)
    executor.begin(np.array([0.0, 0.0] if position is None else position))
    return executor


def run(executor: TrajectoryExecutor, seconds: float) -> list[Reference]:
    track = [executor.goal(PERIOD * tick) for tick in range(round(seconds / PERIOD))]
    assert all(reference is not None for reference in track)
    return [reference for reference in track if reference is not None]


def reading(position: list[float], velocity: list[float] | None = None) -> JointState:
    n = len(position)
    speed = np.zeros(n) if velocity is None else np.array(velocity)
    return JointState(0.0, np.array(position), speed, np.full(n, nan), np.zeros(n), np.ones(n, bool))


def only(joint: int, given_: Trajectory) -> Trajectory:
    mask = np.arange(2) == joint
    return Trajectory(given_.time, given_.position, mask, given_.velocity, given_.acceleration)


def smooth(to: list[float], seconds: float = 1.0) -> Trajectory:
    return path([seconds], [to], [[0.0] * len(to)], [[0.0] * len(to)])


def phases(executor: TrajectoryExecutor) -> list[tuple[str, str]]:
    return [(outcome.id, outcome.phase) for outcome in executor.outcomes()]
