"""PPO of Stable-Baselines3 as it is used here: how it is made, one update, and all that a checkpoint holds.

One thread for torch. Its matrices here are small (a batch of 256 through 64 x 64): a second thread waits for
the first longer than it helps, and the simulations, which do use every core, wait meanwhile.
"""

import io
from collections import deque
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from twind.config.robot_file import load_robot
from twind.learn.batch.batch_core import BatchCore
from twind.learn.policy.policy_file import NetworkLayer, PolicyCard, save
from twind.learn.task.learning_tasks import task_of
from twind.learn.task.plant_model import plant_of
from twind.learn.training.training_settings import TrainingSettings

FORMAT = "twind-checkpoint/1"
THREADS = 1
SLOWEST = 0.05  # share of the learning rate that is left at the end
RECENT = 100  # episodes that the running figures are of


def environments(settings: TrainingSettings, threads: int | None = None) -> Any:
    """As the settings say, not normalised yet; `threads` of a batch: None, every core.

    Raises what `RobotEnv` does.
    """
    if settings.kind == "batch":
        from twind.learn.batch.vec_env import BatchVecEnv

        return BatchVecEnv(
            settings.task,
            settings.envs,
            robot=settings.robot,
            randomise=settings.profile,
            identified=settings.identified,
            threads=threads,
        )
    from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv

    if settings.kind == "subproc":
        return SubprocVecEnv([lambda: _in_a_process(settings)] * settings.envs)
    return DummyVecEnv([lambda: _make_env(settings)] * settings.envs)


def _in_a_process(settings: TrainingSettings) -> Any:
    """Make the environment of a child process, which ignores Ctrl-C.

    Ctrl-C in a terminal reaches every process, and only the learner handles it.
    """
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    return _make_env(settings)


def _make_env(settings: TrainingSettings) -> Any:
    """One environment that ends by itself when its time is up."""
    from gymnasium.wrappers import TimeLimit

    from twind.learn.environment.robot_env import RobotEnv

    env = RobotEnv(settings.task, settings.robot, randomise=settings.profile, identified=settings.identified)
    return TimeLimit(env, env.task.steps(env.shaping.period))


def make_ppo(
    settings: TrainingSettings, rate: Callable[[float], float], *, threads: int | None = None
) -> Any:
    """SB3's PPO on a VecNormalize of the settings' environments. `rate`: share that is left -> learning rate.

    `threads` of a batch: None, every core.
    """
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

    return PPO(
        "MlpPolicy",
        VecNormalize(VecMonitor(environments(settings, threads)), gamma=settings.gamma),
        learning_rate=rate,
        n_steps=settings.rollout,
        batch_size=min(settings.batch, settings.rollout * settings.envs),
        n_epochs=settings.epochs,
        gamma=settings.gamma,
        gae_lambda=settings.gae_lambda,
        clip_range=settings.clip,
        policy_kwargs={
            "net_arch": list(settings.hidden),
            "activation_fn": torch.nn.Tanh,
            "log_std_init": float(np.log(settings.std)),
        },
        seed=settings.seed,
        device="cpu",
    )


class PpoLearner:
    """One PPO with its environments, stepped an update at a time. `close` gives them back."""

    def __init__(
        self,
        settings: TrainingSettings,
        state: bytes | None = None,
        logs: Path | None = None,
        workers: Any = None,
    ) -> None:
        """`state`: of a checkpoint, to go on from; `logs`: folder for TensorBoard.

        `workers`: `RolloutWorkers` that collect; the environments here then serve imitation alone.

        Raises ValueError: the state is none of ours.
        """
        import torch
        from stable_baselines3.common.logger import Logger, TensorBoardOutputFormat

        torch.set_num_threads(THREADS)
        self.settings = settings
        self.model: Any = None  # while it is made it asks for the learning rate
        self.model = make_ppo(settings, lambda _: self._rate())
        self._normal = self.model.get_vec_normalize_env()
        if workers is not None:
            self.model.collect_rollouts = partial(workers.fill, self.model)
        self._logger = Logger(None, [] if logs is None else [TensorBoardOutputFormat(str(logs))])
        self.model.set_logger(self._logger)
        self.model.ep_info_buffer = deque(maxlen=RECENT)
        self.model.ep_success_buffer = deque(maxlen=RECENT)
        if state is not None:
            self._restore(state)
        elif task_of(settings.task).imitates:
            self._imitate()
        # What is drawn from here on depends on seed and steps alone, and repeats nothing drawn before.
        self.model.set_random_seed(_seed(settings.seed, self.steps))

    def _imitate(self) -> None:
        """Begin as the walking engine's gait, with balance by the ankles."""
        from twind.learn.task.gait_reference import GaitTeacher  # needs the extra walk
        from twind.learn.training.behaviour_cloning import clone

        task = task_of(self.settings.task)
        plant = plant_of(load_robot(self.settings.robot), period=task.shaping.period)
        clone(self.model, GaitTeacher(task, plant).act, self.settings.seed)

    @property
    def steps(self) -> int:
        """Number of control steps so far, of all environments and all sessions."""
        return 0 if self.model is None else int(self.model.num_timesteps)

    def update(self) -> None:
        """One rollout, and what is learnt of it."""
        self.model.learn(self.settings.rollout * self.settings.envs, reset_num_timesteps=False)

    def record(self, figures: Mapping[str, float]) -> None:
        """Write figures of an evaluation to the logs, under the names of SB3's `EvalCallback`."""
        for name, value in figures.items():
            self._logger.record(f"eval/{name}", value)
        self._logger.dump(self.steps)

    def recent(self) -> tuple[float, float, float] | None:
        """Return means over the last episodes: return, length (control steps), share that fell.

        None: no episode has ended yet.
        """
        episodes = list(self.model.ep_info_buffer)
        if not episodes:
            return None
        returns, lengths = ([each[name] for each in episodes] for name in ("r", "l"))
        longest = self._longest
        return (
            float(np.mean(returns)),
            float(np.mean(lengths)),
            float(np.mean([each < longest for each in lengths])),
        )

    def state(self) -> bytes:
        """All that goes on: network, optimiser, normalisation, steps."""
        import torch

        normal = {
            name: [torch.as_tensor(np.asarray(each)) for each in (rms.mean, rms.var, rms.count)]
            for name, rms in (("obs", self._normal.obs_rms), ("ret", self._normal.ret_rms))
        }
        data = {
            "format": FORMAT,
            "steps": self.steps,
            "updates": int(self.model._n_updates),
            "policy": self.model.policy.state_dict(),
            "optimiser": self.model.policy.optimizer.state_dict(),
            "normal": normal,
        }
        file = io.BytesIO()
        torch.save(data, file)
        return file.getvalue()

    def close(self) -> None:
        """Give the environments back, finish the logs."""
        self._logger.close()
        self._normal.close()

    def _restore(self, state: bytes) -> None:
        import torch

        try:
            data = torch.load(
                io.BytesIO(state), weights_only=True
            )  # never more: a pickle would run what it says
            if data["format"] != FORMAT:
                raise ValueError(f"is no {FORMAT}")
            self.model.policy.load_state_dict(data["policy"])
            self.model.policy.optimizer.load_state_dict(data["optimiser"])
            self.model.num_timesteps = data["steps"]
            self.model._n_updates = data["updates"]
            for name, rms in (("obs", self._normal.obs_rms), ("ret", self._normal.ret_rms)):
                rms.mean, rms.var, count = (each.numpy() for each in data["normal"][name])
                rms.count = float(count)
        except Exception as error:
            raise ValueError(f"cannot go on from it: {' '.join(str(error).split())[:200]}") from error

    def _rate(self) -> float:
        share = min(1.0, self.steps / self.settings.steps)
        return self.settings.learning_rate * max(SLOWEST, 1.0 - share)

    @property
    def _longest(self) -> int:
        task = task_of(self.settings.task)
        return task.steps(task.shaping.period)


def _seed(seed: int, steps: int) -> int:
    """32 bits that no other pair of seed and steps is likely to have."""
    return int(np.random.SeedSequence([seed, steps]).generate_state(1)[0])


def layers(policy: Any) -> list[NetworkLayer]:
    """Return the layers of an `ActorCriticPolicy` with tanh.

    They map the normalised observation to the mean of the actions.
    """
    from torch import nn

    found = [_layer(each, "tanh") for each in policy.mlp_extractor.policy_net if isinstance(each, nn.Linear)]
    return [*found, _layer(policy.action_net, "none")]


def _layer(linear: Any, after: Any) -> NetworkLayer:
    """A copy: the network goes on learning."""
    weight, bias = (
        each.detach().numpy().astype(np.float32, copy=True) for each in (linear.weight, linear.bias)
    )
    return NetworkLayer(weight, bias, after)


def export(
    path: Path, model: Any, settings: TrainingSettings, core: BatchCore, figures: Mapping[str, float]
) -> None:
    """Write the policy file of `model`, an SB3 PPO on a VecNormalize. Raises InvalidInput, OSError."""
    normal = model.get_vec_normalize_env()
    mean = normal.obs_rms.mean.astype(np.float32)
    std = np.sqrt(normal.obs_rms.var + normal.epsilon).astype(np.float32)
    plant = core.plant
    names = ("forward", "left", "turn")
    card = PolicyCard.for_training(
        settings.task,
        plant.binding.robot.name,
        plant.layout,
        plant.binding.limits,
        plant.default,
        core.shaping,
        command=dict(zip(names, core.task.command, strict=True)),
        trained_steps=model.num_timesteps,
        evaluation=dict(figures),
        notes={"seed": str(settings.seed), "profile": settings.randomisation},
    )
    save(path, layers(model.policy), mean, std, float(normal.clip_obs), card)
