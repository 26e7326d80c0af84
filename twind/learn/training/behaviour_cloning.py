"""A first policy that imitates a teacher: actions of its own, labels of the teacher (DAgger).

Ross, Gordon, Bagnell, "A Reduction of Imitation Learning and Structured Prediction to No-Regret Online
Learning", AISTATS 2011. What it costs counts as steps of no training: the gradient of PPO comes after.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from twind.robot.arrays import Floats

ROUNDS = 12  # of collecting and fitting; the teacher acts in the first, the policy in the last
PASSES = 4  # over all rows, in each round
BATCH = 1024
RATE = 1e-3  # of Adam
DITHER = 0.02  # standard deviation of what is added to actions that are carried out: other states are seen
VALUE_ROUNDS = 4  # with the finished policy, to fit the values that PPO begins with


def clone(model: Any, teacher: Callable[[Any], Any], seed: int) -> float:
    """Fit the policy of `model`, an SB3 PPO on a VecNormalize, to actions (k, n) of `teacher`.

    `teacher` takes observations (k, N), not normalised. Returns the mean square error of the last fit.
    """
    import torch

    env = model.get_vec_normalize_env()
    rng = np.random.default_rng([seed, 1])
    optimiser = torch.optim.Adam(model.policy.parameters(), RATE)
    rows: list[Floats] = []
    labels: list[Floats] = []
    seen = env.reset()
    error = 0.0
    for number in range(ROUNDS):
        share = number / (ROUNDS - 1)  # of robots that the policy drives
        for _ in range(model.n_steps):
            raw = env.get_original_obs()
            wanted = teacher(raw)
            own, _ = model.predict(seen, deterministic=True)
            drives = np.arange(env.num_envs)[:, None] < share * env.num_envs
            action = np.where(drives, own, wanted) + rng.normal(0.0, DITHER, wanted.shape)
            rows.append(raw.copy())
            labels.append(wanted)
            seen, *_ = env.step(np.clip(action, -1.0, 1.0).astype(np.float32))
        error = _fit(model, optimiser, np.concatenate(rows), np.concatenate(labels), rng)
    _fit_values(model, env)
    return error


def _fit(model: Any, optimiser: Any, rows: Floats, labels: Floats, rng: np.random.Generator) -> float:
    import torch

    env = model.get_vec_normalize_env()
    inputs = torch.as_tensor(env.normalize_obs(rows), dtype=torch.float32)
    wanted = torch.as_tensor(labels, dtype=torch.float32)
    error = 0.0
    for _ in range(PASSES):
        losses = []
        for batch in np.array_split(rng.permutation(len(rows)), max(1, len(rows) // BATCH)):
            mean = model.policy.get_distribution(inputs[batch]).distribution.mean
            loss = torch.mean((mean - wanted[batch]) ** 2)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            losses.append(float(loss.detach()))
        error = float(np.mean(losses))
    return error


def _fit_values(model: Any, env: Any) -> None:
    """Fit the values to the discounted rewards of the cloned policy: PPO begins with an idea of them."""
    import torch

    length = VALUE_ROUNDS * model.n_steps
    seen = env.reset()
    inputs = np.zeros((length, *seen.shape), np.float32)
    rewards = np.zeros((length, env.num_envs))
    ended = np.zeros((length, env.num_envs))
    for step in range(length):
        inputs[step] = seen
        action, _ = model.predict(seen, deterministic=True)
        seen, rewards[step], ended[step], _ = env.step(action)
    returns = np.zeros_like(rewards)
    following = np.zeros(env.num_envs)
    for step in reversed(range(length)):
        following = rewards[step] + model.gamma * (1.0 - ended[step]) * following
        returns[step] = following
    keep = length - model.n_steps // 2  # what comes after the end is missing in the last ones
    flat = torch.as_tensor(inputs[:keep].reshape(-1, inputs.shape[-1]))
    wanted = torch.as_tensor(returns[:keep].reshape(-1), dtype=torch.float32)
    parameters = [*model.policy.mlp_extractor.value_net.parameters(), *model.policy.value_net.parameters()]
    optimiser = torch.optim.Adam(parameters, RATE)
    for _ in range(2 * PASSES):
        for batch in torch.split(torch.randperm(len(flat)), BATCH):
            found = model.policy.predict_values(flat[batch]).flatten()
            loss = torch.mean((found - wanted[batch]) ** 2)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
