"""`learn.batch_*`: a batch of robots beside SB3's processes, and beside MuJoCo's own open loop."""

import os
import time
from collections.abc import Callable, Mapping
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
    interleaved,
    spread,
)
from twind.command_line.extras import how_to_add

ID = "twind.learn.envs:twind/Stand-v0"
EIGHT = 8
MANY = 64
MOST = 256
THREADS = 2  # of both, batch and rollout
SIZE = 0.3  # of the random actions: the robots sway, and some fall
# of control a round, of eight robots; of a chunk, the least of many
STEPS = 250
CHUNK = 25
SWAYING = 300  # of control before the first round


def over_subproc() -> Mapping[str, MeasuredFigure]:
    """Environment steps a second, eight robots: one batch, and a process for each."""
    try:
        from stable_baselines3.common.vec_env import SubprocVecEnv

        from twind.learn.batch.vec_env import BatchVecEnv
    except ImportError as missing:
        raise MeasurementUnavailable(f"{missing}: {how_to_add('learn')}") from None
    batch = BatchVecEnv("Stand", EIGHT)
    processes = SubprocVecEnv([_single] * EIGHT)
    try:
        takes = {"batch": _steps(batch), "subproc": _steps(processes)}
        for take in takes.values():
            take()  # warm
        found = interleaved(ROUNDS, takes)
    finally:
        processes.close()
    ratios = [one / other for one, other in zip(found["batch"], found["subproc"], strict=True)]
    note = (
        f"{median(found['batch']):.0f} against {median(found['subproc']):.0f} environment steps/s, "
        f"{os.cpu_count()} cores, random actions, falls included; {spread(ratios, '×')}"
    )
    return {"learn.batch_over_subproc8": MeasuredFigure(median(ratios), note)}


def _single() -> Any:
    import gymnasium

    return gymnasium.make(ID)


def _steps(env: Any) -> Callable[[], float]:
    """Environment steps a second of one round."""
    actions = _actions(STEPS, EIGHT, env.action_space.shape[0])
    env.seed(0)
    env.reset()

    def take() -> float:
        began = time.perf_counter()
        for action in actions:
            env.step(action)
        return STEPS * EIGHT / (time.perf_counter() - began)

    return take


def over_rollout() -> Mapping[str, MeasuredFigure]:
    """Physics steps a second of the whole environment, and of `mujoco.rollout` on the same targets."""
    try:
        from twind.learn.batch.batch_core import BatchCore
    except ImportError as missing:
        raise MeasurementUnavailable(f"{missing}: {how_to_add('learn')}") from None
    ratios = {}
    notes = []
    for count in (EIGHT, MANY, MOST):
        both = RolloutComparison(
            BatchCore("Stand", count, threads=THREADS), max(1, STEPS * EIGHT // count // CHUNK)
        )
        both.take()  # warm
        ended = both.ended
        found = [both.take() for _ in range(ROUNDS)]
        ratios[count] = [one / other for one, other in found]
        fast, open_loop = (median(each) for each in zip(*found, strict=True))
        notes.append(
            f"{count} robots {median(ratios[count]):.2f} ({fast:.0f} against {open_loop:.0f} mj_steps/s, "
            f"{(both.ended - ended) / ROUNDS:.0f} episodes end in a round, {spread(ratios[count], '×')})"
        )
    note = (
        f"whole environment, ends of episodes included, against steps alone, {THREADS} threads each, same "
        f"models, states and targets: {'; '.join(notes)}"
    )
    return {"learn.batch_over_rollout": MeasuredFigure(median(ratios[MANY]), note)}


class RolloutComparison:
    """Rounds of a batch that runs on and on, and of the same physics in MuJoCo's open loop.

    Each chunk of control steps is rolled out from the states that the batch was in: what falls in the batch
    and begins anew, falls on in the open loop for the rest of a chunk at most.
    """

    def __init__(self, core: Any, chunks: int) -> None:
        """A round is `chunks` chunks."""
        from mujoco.rollout import Rollout

        self.ended = 0  # episodes, ever
        self._core = core
        self._chunks = chunks
        model = core.plant.model
        self._physics = mujoco.mjtState.mjSTATE_FULLPHYSICS
        self._first = np.zeros((core.count, mujoco.mj_stateSize(model, self._physics)))
        steps = CHUNK * core.plant.substeps
        self._states = np.zeros((core.count, steps, self._first.shape[1]))
        self._told = np.zeros((core.count, steps, model.nsensordata))
        self._targets = np.zeros((core.count, CHUNK, model.nu))
        self._pool = Rollout(nthread=THREADS)
        self._data = [mujoco.MjData(model) for _ in range(THREADS)]
        self._rng = np.random.default_rng(0)
        core.seed(range(core.count))
        core.reset()
        for action in self._actions(SWAYING):  # until episodes end at any time
            core.step(action)

    def take(self) -> tuple[float, float]:
        """`mj_step`s a second: of the batch, of the open loop."""
        core = self._core
        spent = [0.0, 0.0]
        for _ in range(self._chunks):
            batch = core.body.batch
            models = [batch.get_model(each) for each in range(core.count)]
            for each, state in enumerate(self._first):
                mujoco.mj_getState(core.plant.model, batch.get_data(each), state, self._physics)
            spent[0] += self._batch()
            spent[1] += self._rollout(models)
        total = core.count * self._chunks * CHUNK * core.plant.substeps
        return total / spent[0], total / spent[1]

    def _batch(self) -> float:
        core = self._core
        spent = 0.0
        for at, action in enumerate(self._actions(CHUNK)):
            began = time.perf_counter()
            step = core.step(action)
            spent += time.perf_counter() - began
            self.ended += len(step.ended)
            self._targets[:, at] = core.body.batch.ctrl
        return spent

    def _rollout(self, models: list[Any]) -> float:
        held = np.repeat(self._targets, self._core.plant.substeps, axis=1)
        began = time.perf_counter()
        self._pool.rollout(models, self._data, self._first, held, state=self._states, sensordata=self._told)
        return time.perf_counter() - began

    def _actions(self, steps: int) -> Any:
        """(steps, count, n): random ones, others each time."""
        shape = (steps, self._core.count, self._core.joints)
        return self._rng.uniform(-SIZE, SIZE, shape).astype(np.float32)


def _actions(steps: int, count: int, joints: int) -> Any:
    """(steps, count, n), the same in every run."""
    return np.random.default_rng(0).uniform(-SIZE, SIZE, (steps, count, joints)).astype(np.float32)


MEASUREMENTS = (
    Measurement({"learn.batch_over_subproc8": FigureSpec("ratio", "≥ 2")}, over_subproc),
    Measurement({"learn.batch_over_rollout": FigureSpec("ratio", "≥ 0.85")}, over_rollout),
)
