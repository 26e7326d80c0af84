"""A batch as a Stable-Baselines3 `VecEnv`: what `twindctl train` trains on."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from twind.learn.batch.batch_core import BatchCore
from twind.learn.environment.robot_env import spaces_of
from twind.learn.task.learning_tasks import command_in
from twind.learn.task.observation import Observations
from twind.robot.arrays import Bools

Info = dict[str, Any]
_SHARED = "the robots of a batch share one object; what differs between them is their state and their draw"


class BatchVecEnv(VecEnv):
    """`count` robots with one task; with one seed the same as a DummyVecEnv of single environments.

    The terms of the reward are in the info of an episode's last step alone: thousands of small dicts a second
    cost time.
    """

    def __init__(self, task: str, count: int, *, render_mode: str | None = None, **settings: Any) -> None:
        """Make the batch; `settings`: those of `BatchCore`. `render_mode`: None or "rgb_array"."""
        self.core = core = BatchCore(task, count, looks=render_mode is not None, **settings)
        self._mode = render_mode
        super().__init__(count, *spaces_of(core.plant))
        self._actions: NDArray[Any] = np.zeros((count, core.joints))

    def reset(self) -> Observations:
        """New episodes of all, with the seeds and options that were given since the last one."""
        command, *others = [command_in(options) for options in self._options]
        if any(each != command for each in others):
            raise ValueError("options: one command for all robots of a batch")
        self.core.seed(self._seeds)
        observation = self.core.reset(command=command)
        self._fill_reset_info(range(self.num_envs))
        self._reset_seeds()
        self._reset_options()
        return observation

    def step_async(self, actions: NDArray[Any]) -> None:
        """Keep the actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[Observations, NDArray[np.float32], Bools, list[Info]]:
        """One control period of all."""
        step = self.core.step(self._actions)
        infos: list[Info] = [{"TimeLimit.truncated": False} for _ in range(self.num_envs)]
        for each, last in zip(step.ended.tolist(), step.last, strict=True):
            infos[each] = {
                **{name: float(term[each]) for name, term in step.terms.items()},
                "terminal_observation": last,
                "TimeLimit.truncated": bool(step.truncated[each] and not step.fallen[each]),
            }
        self._fill_reset_info(step.ended.tolist())
        return step.observation, step.reward.astype(np.float32), step.fallen | step.truncated, infos

    def close(self) -> None:
        """Give the camera back."""
        self.core.body.close()

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """Each robot from the side."""
        return [self.core.body.picture(each) for each in range(self.num_envs)]

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """`render_mode`, or what all robots share: the core's. Raises AttributeError."""
        value = self._mode if attr_name == "render_mode" else getattr(self.core, attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Raises AttributeError: the robots of a batch are no objects."""
        raise AttributeError(f"{attr_name}: {_SHARED}")

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Raises AttributeError: the robots of a batch are no objects."""
        raise AttributeError(f"{method_name}(): {_SHARED}")

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """None is."""
        return [False for _ in self._get_indices(indices)]

    def _fill_reset_info(self, begun: Sequence[int]) -> None:
        for each in begun:
            self.reset_infos[each] = {"command": tuple(self.core.command[each].tolist())}
