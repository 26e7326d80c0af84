"""`loop.virtual_hour`: what an hour of robot costs under the fake clock, and the same with MuJoCo muscles.

The hour is taken in rounds of armed, moving robot; the rounds of both muscles take turns.
"""

import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack

import numpy as np

from bench.harness import (
    ROUNDS,
    FigureSpec,
    MeasuredFigure,
    Measurement,
    as_in_the_loop,
    interleaved,
    medians,
    spread,
)
from bench.in_process_daemon import InProcessDaemon, indoors
from twind import link
from twind.robot.modes import RobotState
from twind.robot.trajectory import Trajectory

HOUR = 3600.0  # s
MOTION = 60.0  # s of one trajectory of all joints, the longest that the gate takes
ROUND = {"first-order": HOUR / ROUNDS, "mujoco": MOTION}  # s of robot in one round
SIZE = 0.05  # rad


def take() -> Mapping[str, MeasuredFigure]:
    """CPU time of an hour: the median round, scaled to the hour."""
    with ExitStack() as stack:
        robots = {
            name: stack.enter_context(indoors(physics=name == "mujoco")) for name in ("first-order", "mujoco")
        }
        with as_in_the_loop():
            found = interleaved(ROUNDS, {name: moving_round(robots[name], ROUND[name]) for name in robots})
        ticks = {name: robot.loop.figures.ticks for name, robot in robots.items()}
    middle = medians(found)
    notes = {
        name: f"armed, 24 joints moving, {ROUNDS} rounds of {ROUND[name]:g} s of robot, {ticks[name]} ticks; "
        f"CPU time, {middle[name] / HOUR * 1e4:.0f} µs a tick; {spread(found[name], 's')}"
        for name in found
    }
    return {
        "loop.virtual_hour": MeasuredFigure(middle["first-order"], notes["first-order"]),
        "loop.virtual_hour_mujoco": MeasuredFigure(middle["mujoco"], notes["mujoco"] + "; scaled to an hour"),
    }


def moving_round(robot: InProcessDaemon, span: float) -> Callable[[], float]:
    """CPU time (s) that an hour takes, from `span` s of it."""

    def take() -> float:
        before = time.process_time()
        start = robot.clock.now()
        ticks = robot.loop.figures.ticks
        while robot.clock.now() - start < span - 0.5:
            robot.send(
                link.AcquireLease
            )  # held by the open trajectory; it lapsed if the last one ended long ago
            ticket = robot.submit(_swing(robot))
            robot.run(MOTION)
            robot.demand(ticket, phase="succeeded")
        used = time.process_time() - before
        missing = round(span / robot.loop.robot.period) - (robot.loop.figures.ticks - ticks)
        if robot.loop.condition.state is not RobotState.ARMED or missing > 0:
            raise RuntimeError(
                f"state {robot.loop.condition.state}, {missing} ticks missing: this was no hour of moving"
            )
        return used * HOUR / span

    return take


def _swing(robot: InProcessDaemon) -> Trajectory:
    """All joints to and fro once a second, ending where they began, a little before the next one comes."""
    reference = robot.loop.executor.reference
    assert reference is not None
    time = np.arange(1.0, MOTION, 1.0)
    out = np.where(reference.position > 0.0, -SIZE, SIZE)
    position = reference.position + np.where(np.arange(len(time)) % 2, 0.0, 1.0)[:, None] * out
    position[-1] = reference.position
    return Trajectory(time, position, np.ones(len(out), np.bool_), np.zeros_like(position))


MEASUREMENTS = (
    Measurement(
        {"loop.virtual_hour": FigureSpec("s", "≤ 90"), "loop.virtual_hour_mujoco": FigureSpec("s", "≤ 180")},
        take,
    ),
)
