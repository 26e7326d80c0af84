"""Rollouts that workers of a Ray cluster collect, for `twindctl train --ray`.

A worker is an actor with a share of the environments and a copy of the policy: it collects a whole rollout
by itself, so that weights go out and one answer comes back per update, nothing per step. Ray starts a worker
that died again and repeats its call: no step of a rollout is lost, none counts twice.
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import ray
from ray.exceptions import RayError, RayTaskError
from stable_baselines3.common.running_mean_std import RunningMeanStd

from twind.exceptions import OperationFailed
from twind.learn.training.ppo_learner import THREADS, make_ppo
from twind.learn.training.training_settings import TrainingSettings, describe_changes

RESTARTS = 20  # of one worker
TIMEOUT = 600.0  # s, of one rollout: a cluster without a free core lets a call wait for ever
# Of SB3's RolloutBuffer: (steps, environments, …) each.
ARRAYS = (
    "observations",
    "actions",
    "rewards",
    "episode_starts",
    "values",
    "log_probs",
    "advantages",
    "returns",
)
STATISTICS = ("obs_rms", "ret_rms")  # of SB3's VecNormalize
Place = tuple[str, int]  # address of the machine, process id


class StatisticsTally(RunningMeanStd):
    """Mean and variance that go on from `base`; `added` are those of what came since."""

    def __init__(self, base: Any) -> None:
        super().__init__(shape=base.mean.shape)
        self.added = RunningMeanStd(0.0, base.mean.shape)
        self.mean = base.mean
        self.var = base.var
        self.count = base.count

    def update_from_moments(self, mean: Any, var: Any, count: float) -> None:
        """As SB3 has it, for both."""
        super().update_from_moments(mean, var, count)
        self.added.update_from_moments(mean, var, count)


@dataclass(frozen=True, slots=True)
class WorkerRollout:
    """The rollout of one worker."""

    place: Place
    arrays: dict[str, Any]  # those of ARRAYS
    episodes: list[dict[str, Any]]  # that ended: SB3's `ep_info_buffer`
    added: dict[str, Any]  # to each of STATISTICS


class RolloutWorker:
    """The actor: runs in a process of the cluster."""

    def __init__(self, settings: TrainingSettings) -> None:
        """`settings.envs` is the share. Raises ValueError: this machine's robot or ranges are others."""
        import torch

        changed = describe_changes(settings)
        if changed:
            raise ValueError(f"on {ray.util.get_node_ip_address()}: {'; '.join(changed)}")
        torch.set_num_threads(THREADS)
        self._model = make_ppo(settings, lambda _: settings.learning_rate, threads=1)

    def place(self) -> Place:
        """Return machine and process of this worker."""
        return ray.util.get_node_ip_address(), os.getpid()

    def collect(self, policy: Any, statistics: Mapping[str, Any], seed: int) -> WorkerRollout:
        """One rollout of `policy`, a state dict. Environments go on from the last one, new ones are reset.

        `seed` decides what is drawn for the actions; of new environments, for the episodes too.
        """
        import torch

        model = self._model
        env = model.get_vec_normalize_env()
        model.policy.load_state_dict(policy)
        tallies = {name: StatisticsTally(base) for name, base in statistics.items()}
        for name, tally in tallies.items():
            setattr(env, name, tally)
        if model._last_obs is None:
            model.set_random_seed(seed)
        torch.manual_seed(seed)
        model.ep_info_buffer = None  # the next line makes a new one
        _, callback = model._setup_learn(0, reset_num_timesteps=False)
        model.collect_rollouts(env, callback, model.rollout_buffer, model.n_steps)
        return WorkerRollout(
            self.place(),
            {name: getattr(model.rollout_buffer, name) for name in ARRAYS},
            list(model.ep_info_buffer),
            {name: tally.added for name, tally in tallies.items()},
        )


class RolloutWorkers:
    """All workers of a training, on the cluster that this process is connected to."""

    def __init__(self, settings: TrainingSettings, count: int) -> None:
        """Share the environments among `count` workers. Raises OperationFailed: one cannot start."""
        self._seed = settings.seed
        # Without `num_cpus` an actor needs a core to start and none to run: where a machine is lost, its
        # workers start again on the others, although those are busy.
        actor = ray.remote(RolloutWorker).options(
            max_restarts=RESTARTS, max_task_retries=-1, scheduling_strategy="SPREAD"
        )
        shares = np.array_split(np.arange(settings.envs), count)
        self._actors = [actor.remote(replace(settings, envs=len(share))) for share in shares]
        self.places: list[Place] = _results([each.place.remote() for each in self._actors])
        self.restarts = 0

    def fill(self, model: Any, env: Any, callback: Any, buffer: Any, n_rollout_steps: int) -> bool:
        """Do what `collect_rollouts` of `model`, an SB3 PPO, does, by the workers.

        `env`, its VecNormalize, is not stepped: its statistics take in what the workers saw.
        Raises OperationFailed: no worker is left, or none answers.
        """
        callback.on_rollout_start()
        statistics = {name: getattr(env, name) for name in STATISTICS}
        sent = [ray.put(each) for each in (model.policy.state_dict(), statistics)]
        rollouts: list[WorkerRollout] = _results(
            [
                each.collect.remote(*sent, self._seed_of(model.num_timesteps, number))
                for number, each in enumerate(self._actors)
            ]
        )
        buffer.reset()
        for name in ARRAYS:
            setattr(buffer, name, np.concatenate([each.arrays[name] for each in rollouts], axis=1))
        buffer.full = True
        for each in rollouts:
            model.ep_info_buffer.extend(each.episodes)
            for name, added in each.added.items():
                statistics[name].combine(added)
        model.num_timesteps += n_rollout_steps * env.num_envs
        self.restarts += sum(each.place != place for each, place in zip(rollouts, self.places, strict=True))
        self.places = [each.place for each in rollouts]
        callback.on_rollout_end()
        return True

    def _seed_of(self, steps: int, number: int) -> int:
        return int(np.random.SeedSequence([self._seed, steps, number]).generate_state(1)[0])


def _results(calls: list[Any]) -> Any:
    """Raises OperationFailed, with the reason of a worker or the last line of what Ray reports."""
    try:
        return ray.get(calls, timeout=TIMEOUT)
    except RayTaskError as error:
        raise OperationFailed(f"a worker of Ray: {error.cause}") from None
    except RayError as error:
        lines = [line.strip() for line in str(error).splitlines() if line.strip()]
        last = lines[-1] if lines else type(error).__name__
        raise OperationFailed(f"no worker of Ray is left for a share of the environments: {last}") from None
