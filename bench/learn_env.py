"""`learn.env_over_*`: an environment beside the bare physics that it steps, and Gymnasium's own humanoid.

The physics gets the same controls from the same starts, falls and resets included: the same states. Raw is
the robot's MJCF as it is. Own is the environment's model, which is faster (no islands, no sensors of the
robot's own): like for like, as Gymnasium's humanoid is divided by its own model too.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from statistics import median
from typing import Any

import mujoco
import numpy as np

from bench.harness import (
    ROUNDS,
    FigureSpec,
    MeasuredFigure,
    Measurement,
    MeasurementUnavailable,
    as_in_the_loop,
    interleaved,
    spread,
)
from twind.command_line.extras import how_to_add
from twind.robot.arrays import Floats

STEPS = 2000  # of control a round: some forty episodes of random actions
PEER = "Gymnasium Humanoid-v5"


@dataclass(frozen=True, slots=True)
class RandomActionEpisode:
    """Statistics of an environment under random actions."""

    actions: Floats  # (k, nu)
    controls: Floats  # (k, nu), as its physics got them
    starts: Mapping[int, tuple[Floats, Floats]]  # by step: qpos, qvel that an episode began in


def over_raw() -> Mapping[str, MeasuredFigure]:
    """CPU time of one control step with random actions, without Gymnasium's wrappers."""
    try:
        import gymnasium

        from twind.learn.environment.robot_env import RobotEnv
    except ImportError as missing:
        raise MeasurementUnavailable(f"{missing}: {how_to_add('learn')}") from None
    ours = RobotEnv("Humanoid")
    course = _course(ours, ours.body)
    plain = mujoco.MjModel.from_xml_path(str(ours.plant.binding.robot.mjcf_path))
    takes = {
        "env": _env(ours, course),
        "raw": _raw(plain, course, ours.plant.substeps),
        "own": _raw(ours.plant.model, course, ours.plant.substeps),
    }
    try:
        theirs: Any = gymnasium.make("Humanoid-v5").unwrapped
    except (ImportError, gymnasium.error.Error) as missing:
        note = f"; no {PEER}: {missing}"
        peer = False
    else:
        note = ""
        peer = True
        their_course = _course(theirs, theirs)
        takes["peer"] = _env(theirs, their_course)
        takes["peer raw"] = _raw(theirs.model, their_course, theirs.frame_skip)
    for take in takes.values():
        take()  # warm
    with as_in_the_loop():
        found = interleaved(2 * ROUNDS, takes)
    same = f"for {ours.plant.substeps} steps with the same controls, starts and falls"
    peers = {PEER: median(_over(found, "peer", "peer raw")) if peer else None}
    figures = {}
    for key, bare, whose in (
        ("learn.env_over_raw", "raw", "h24.xml as it is"),
        ("learn.env_over_own", "own", "its own model, without islands; the peer is over its own too"),
    ):
        ratios = _over(found, "env", bare)
        told = (
            f"twind/Humanoid-v0, {median(found['env']):.1f} against {median(found[bare]):.1f} µs {same} of "
            f"{whose}; {spread(ratios, '×')}"
        )
        like = bare == "own"
        figures[key] = MeasuredFigure(median(ratios), told + note * like, peers if like else {})
    return figures


def _over(found: Mapping[str, list[float]], one: str, other: str) -> list[float]:
    return [mine / bare for mine, bare in zip(found[one], found[other], strict=True)]


def _course(env: Any, body: Any) -> RandomActionEpisode:
    """`body` has the `data` of `env`."""
    rng = np.random.default_rng(0)
    space = env.action_space
    actions = rng.uniform(space.low, space.high, (STEPS, *space.shape)).astype(np.float32)
    controls = np.zeros((STEPS, body.data.ctrl.size))
    starts = {}
    env.reset(seed=0)
    over = True
    for step, action in enumerate(actions):
        if over and step:
            env.reset()
        if over:
            starts[step] = body.data.qpos.copy(), body.data.qvel.copy()
        _, _, over, _, _ = env.step(action)
        controls[step] = body.data.ctrl
    return RandomActionEpisode(actions, controls, starts)


def _env(env: Any, course: RandomActionEpisode) -> Callable[[], float]:
    """µs of CPU time a step, resets included."""

    def take() -> float:
        env.reset(seed=0)
        began = time.process_time()
        for action in course.actions:
            _, _, over, _, _ = env.step(action)
            if over:
                env.reset()
        return (time.process_time() - began) / STEPS * 1e6

    return take


def _raw(model: Any, course: RandomActionEpisode, substeps: int) -> Callable[[], float]:
    """The same of `mj_step` alone; an episode begins by writing its state."""
    data = mujoco.MjData(model)
    control = data.ctrl
    controls = course.controls
    starts = course.starts

    def take() -> float:
        began = time.process_time()
        for step in range(STEPS):
            if step in starts:
                mujoco.mj_resetData(model, data)
                data.qpos[:], data.qvel[:] = starts[step]
            control[:] = controls[step]
            mujoco.mj_step(model, data, substeps)
        return (time.process_time() - began) / STEPS * 1e6

    return take


MEASUREMENTS = (
    Measurement(
        {"learn.env_over_raw": FigureSpec("ratio", "≤ 1.10"), "learn.env_over_own": FigureSpec("ratio")},
        over_raw,
    ),
)
