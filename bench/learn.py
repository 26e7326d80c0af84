"""`learn.*`: the figures of learning, put together; `learn.ppo_steps_per_hour` is taken here.

Environments, batch and policies have files of their own, `learn_*.py`.
"""

import os
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from statistics import median
from typing import Any

from bench import learn_batch, learn_env, learn_policy
from bench.harness import (
    ROUNDS,
    FigureSpec,
    MeasuredFigure,
    Measurement,
    MeasurementUnavailable,
    interleaved,
    spread,
)
from twind.command_line.extras import how_to_add

UPDATES = 3  # a round; each is a rollout of 8 environments and what is learnt of it
HOUR = 3600e-6  # steps a second as millions an hour


def ppo_steps_per_hour() -> Mapping[str, MeasuredFigure]:
    """Control steps of a training without its evaluations, wall time, as `twindctl train stand` has it."""
    try:
        from twind.learn.training.ppo_learner import THREADS, PpoLearner
        from twind.learn.training.training_settings import DEFAULTS
    except ImportError as missing:
        raise MeasurementUnavailable(f"{missing}: {how_to_add('learn')}") from None
    settings = DEFAULTS["Stand"]
    kinds = {"twind": "batch", "SB3 on SubprocVecEnv": "subproc", "SB3 on DummyVecEnv": "dummy"}
    learners = {name: PpoLearner(replace(settings, kind=kind)) for name, kind in kinds.items()}
    try:
        for learner in learners.values():
            learner.update()  # warm: torch, workers
        found = interleaved(ROUNDS, {name: _rate(learner) for name, learner in learners.items()})
    finally:
        for learner in learners.values():
            learner.close()
    peers: dict[str, float | None] = {name: median(rows) for name, rows in found.items() if name != "twind"}
    note = (
        f"{settings.envs} environments, rollout {settings.rollout}, batch {settings.batch}, "
        f"{settings.epochs} epochs, {'-'.join(map(str, settings.hidden))}, torch {THREADS} thread, "
        f"{os.cpu_count()} cores; {spread(found['twind'], 'M/h')}"
    )
    return {"learn.ppo_steps_per_hour": MeasuredFigure(median(found["twind"]), note, peers)}


def _rate(learner: Any) -> Callable[[], float]:
    """Millions of steps an hour, of one round."""

    def take() -> float:
        steps = learner.steps
        began = time.perf_counter()
        for _ in range(UPDATES):
            learner.update()
        return HOUR * (learner.steps - steps) / (time.perf_counter() - began)

    return take


MEASUREMENTS = (
    *learn_env.MEASUREMENTS,
    *learn_batch.MEASUREMENTS,
    Measurement({"learn.ppo_steps_per_hour": FigureSpec("M/h", "≥ 5")}, ppo_steps_per_hour),
    *learn_policy.MEASUREMENTS,
)
