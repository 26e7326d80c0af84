"""A batch as a Gymnasium vector environment: `gymnasium.make_vec("twind.learn.envs:twind/Stand-v0", 8)`.

It begins a new episode in the step that ends one (SAME_STEP), because the core does. With NEXT_STEP every
robot that fell would stand still for one step, which a learner would have to leave out.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from twind.learn.batch.batch_core import BatchCore, BatchStep
from twind.learn.environment.robot_env import spaces_of
from twind.learn.task.action_shaping import ActionShaping
from twind.learn.task.learning_tasks import command_in
from twind.learn.task.observation import Observations
from twind.robot.arrays import Bools, Floats


class BatchVectorEnv(VectorEnv):
    """`num_envs` robots with one task. Robot i is the single environment with seed + i, bit for bit."""

    metadata: Mapping[str, object] = {
        "render_modes": ["rgb_array"],
        "render_fps": round(1.0 / ActionShaping().period),
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }

    def __init__(
        self,
        task: str,
        num_envs: int = 1,
        max_episode_steps: int | None = None,
        *,
        render_mode: str | None = None,
        backend: str = "sim",
        **settings: Any,
    ) -> None:
        """Make the batch; `settings`: those of `BatchCore`. `max_episode_steps`: None, as the task says."""
        if backend != "sim":
            raise ValueError(f"backend {backend!r}: a batch simulates; one robot is one environment: `make`")
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"render_mode {render_mode!r}: None or 'rgb_array', which `render()` returns")
        self.core = core = BatchCore(
            task, num_envs, episode_steps=max_episode_steps, looks=render_mode is not None, **settings
        )
        self.num_envs = num_envs
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": round(1.0 / core.shaping.period)}
        self.single_observation_space, self.single_action_space = spaces_of(core.plant)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._every = np.ones(num_envs, np.bool_)

    @property
    def np_random(self) -> tuple[np.random.Generator, ...]:
        """Each robot's generator."""
        return tuple(self.core.rngs)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, object] | None = None,
    ) -> tuple[Observations, dict[str, object]]:
        """New episodes. `seed`: robot i gets seed + i, or its own of a list.

        `options`: {"command": (m/s forward, m/s left, rad/s)}, {"reset_mask": (num_envs,)} for some of them.
        Raises ValueError: a list or a mask of another length, other options, no command that can be.
        """
        given = options or {}
        command = command_in(options, "reset_mask")
        mask = np.asarray(given.get("reset_mask", self._every), np.bool_)
        seeds = [seed + each for each in range(self.num_envs)] if isinstance(seed, int) else seed
        for what, size in (("seeds", None if seeds is None else len(seeds)), ("reset_mask", mask.size)):
            if size not in (None, self.num_envs):
                raise ValueError(f"{what}: {size} for {self.num_envs} environments")
        if seeds is not None:
            self.core.seed([each if chosen else None for each, chosen in zip(seeds, mask, strict=True)])
        observation = self.core.reset(np.flatnonzero(mask), command)
        return observation, self._commands(mask)

    def step(self, actions: NDArray[Any]) -> tuple[Observations, Floats, Bools, Bools, dict[str, object]]:
        """Run one control period of all robots.

        `final_obs` has the last observation of each episode that ended.
        """
        step = self.core.step(actions)
        return step.observation, step.reward, step.fallen, step.truncated, self._info(step)

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Each robot from the side; None without render_mode."""
        if self.render_mode is None:
            return None
        return tuple(self.core.body.picture(each) for each in range(self.num_envs))

    def close_extras(self, **kwargs: Any) -> None:
        """Give the camera back."""
        self.core.body.close()

    def _info(self, step: BatchStep) -> dict[str, object]:
        if not step.ended.size:
            return _masked(step.terms, self._every)
        ended = np.zeros(self.num_envs, np.bool_)
        ended[step.ended] = True
        last = np.full(self.num_envs, None, object)
        for each, observation in zip(step.ended, step.last, strict=True):
            last[each] = observation
        final = {"final_obs": last, "final_info": _masked(step.terms, ended)}
        others = {} if ended.all() else _masked(step.terms, ~ended)
        return {**others, **self._commands(ended), **_masked(final, ended)}

    def _commands(self, mask: Bools) -> dict[str, object]:
        """Return the commands (count, 3) of the episodes that have just begun, those in `mask`."""
        return _masked({"command": self.core.command.copy()}, mask)


def _masked(info: Mapping[str, object], mask: Bools) -> dict[str, object]:
    """Return arrays in Gymnasium's vector form: each array, and as `_name` the mask of its robots."""
    return {**info, **{f"_{name}": mask for name in info}}
