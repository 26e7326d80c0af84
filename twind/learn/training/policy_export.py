"""Export of a PPO network as a policy file: the actor's mean and the normalisation, without the rest."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from twind.learn.batch.batch_core import BatchCore
from twind.learn.policy.policy_file import NetworkLayer, PolicyCard, save
from twind.learn.training.training_settings import TrainingSettings


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
        notes={"seed": str(settings.seed), "profile": settings.profile or "none"},
    )
    save(path, layers(model.policy), mean, std, float(normal.clip_obs), card)
