"""Train policies that squat in time to a clock, without twind; write ONNX files, cards and test vectors.

    twindctl robot export h24-standing --mjcf h24/h24.xml
    python train_squat.py h24/h24.xml --out squat [--steps 300000] [--seed 0]

It needs mujoco, gymnasium, stable-baselines3, torch and onnx. The body goes 4 cm down and up in 2 s.
`squat.onnx` is learnt by PPO of Stable-Baselines3. `squat_lstm.onnx`, an LSTM, learns from it as a student,
which sees no velocity of a joint, not its last action, and only the sine of the clock.
The last line is JSON: error of the height (mm, rms), return and steps of an episode of each, of actions of
zero, and of the LSTM with a state that is always zero.
"""

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv

STANCE = {"hip_pitch": -0.3, "knee": 0.6, "ankle_pitch": -0.3}  # rad
JOINTS = [f"{side}_{name}" for side in "lr" for name in STANCE]
RATE = 50  # actions per second
PERIOD = 2.0  # s, of a squat
DEPTH = 0.04  # m
SCALE = 0.6  # rad per unit of an action
SECONDS = 10  # of an episode
HIDDEN = 32  # of the LSTM
FEW = ["joint_position: {}", "base_angular_velocity: {scale: 0.25}", "projected_gravity: {}", "phase_sin: {}"]
ALL = [*FEW, "phase_cos: {}", "joint_velocity: {scale: 0.1}", "last_action: {}"]
SEEN = 13  # entries of FEW, the first of an observation
STATE = f"h_in: {{output: h_out, shape: [1, 1, {HIDDEN}]}}, c_in: {{output: c_out, shape: [1, 1, {HIDDEN}]}}"
CARD = """\
format: twind-card/1
name: {name}
robot: h24-standing
rate_hz: {rate}
joints: [{joints}]
default_rad: {{{default}}}
inputs:
  obs:
    terms:
      {terms}
{state}action: {{output: actions, scale_rad: {scale}, clip: [-1.0, 1.0], path: linear}}
phase: {{period_s: {period}}}
test: {{file: {name}.npz, tolerance: 1.0e-4}}
"""


class Squat(gymnasium.Env[Any, Any]):
    """The exported model; six joints of the legs are moved, the others hold."""

    def __init__(self, mjcf: str) -> None:
        self.model = mujoco.MjModel.from_xml_path(mjcf)
        self.data = mujoco.MjData(self.model)
        self.substeps = round(1.0 / RATE / self.model.opt.timestep)
        self.at = np.array([self.model.joint(name).qposadr[0] for name in JOINTS])
        self.dof = np.array([self.model.joint(name).dofadr[0] for name in JOINTS])
        self.act = np.array([self.model.actuator(name).id for name in JOINTS])
        self.default = np.array([STANCE[name[2:]] for name in JOINTS])
        self.kp = self.model.actuator_gainprm[:, 0].copy()
        self.data.qpos[self.at] = self.data.ctrl[self.act] = self.default
        mujoco.mj_step(self.model, self.data, 400)  # 2 s: it comes to rest on its feet
        self.start = self.data.qpos.copy()
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (SEEN + 13,), np.float32)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (len(JOINTS),), np.float32)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        """Standing; friction of the floor and stiffness of the servos differ between episodes."""
        super().reset(seed=seed)
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:] = self.start
        self.model.geom("floor").friction[0] = self.np_random.uniform(0.6, 1.0)
        share = self.np_random.uniform(0.8, 1.2)
        self.model.actuator_gainprm[:, 0] = share * self.kp
        self.model.actuator_biasprm[:, 1] = -share * self.kp
        self.data.ctrl[self.act] = self.default
        mujoco.mj_forward(self.model, self.data)
        self.action = np.zeros(len(JOINTS))
        self.steps = 0
        return self.observe(), {}

    def observe(self) -> Any:
        """Return the terms of the card, in its order."""
        clock = 2.0 * np.pi * self.steps / RATE / PERIOD
        down = -self.data.body("torso").xmat.reshape(3, 3)[2]
        few = [self.data.qpos[self.at] - self.default, 0.25 * self.data.sensor("imu_gyro").data, down]
        more = [[np.sin(clock)], [np.cos(clock)], 0.1 * self.data.qvel[self.dof], self.action]
        return np.concatenate([*few, *more]).astype(np.float32)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, float]]:
        """Move the goals to the new targets at constant speed, as `path: linear` of the card says."""
        before = self.data.ctrl[self.act]
        target = self.default + SCALE * np.clip(action, -1.0, 1.0)
        for share in np.arange(1, self.substeps + 1) / self.substeps:
            self.data.ctrl[self.act] = before + share * (target - before)
            mujoco.mj_step(self.model, self.data)
        jerk = float(np.square(action - self.action).mean())
        self.action = np.array(action, np.float64)
        self.steps += 1
        wanted = -0.5 * DEPTH * (1.0 - np.cos(2.0 * np.pi * self.steps / RATE / PERIOD))
        error = float(self.data.qpos[2] - self.start[2] - wanted)
        upright = float(self.data.body("torso").xmat[8])
        fallen = upright < 0.8
        cost = 5.0 * (1.0 - upright) + 0.5 * jerk + 5.0 * fallen
        reward = float(np.exp(-((error / 0.01) ** 2))) - cost
        return self.observe(), reward, fallen, self.steps >= SECONDS * RATE, {"error": error}


class Actor(torch.nn.Module):
    """The network of PPO that acts, without noise."""

    def __init__(self, policy: Any) -> None:
        super().__init__()
        self.policy = policy

    def forward(self, obs: Any) -> Any:
        """Return the actions."""
        hidden = self.policy.mlp_extractor.forward_actor(obs)
        return self.policy.action_net(hidden).clamp(-1.0, 1.0)


class Student(torch.nn.Module):
    """An LSTM whose state is given and returned."""

    def __init__(self) -> None:
        super().__init__()
        self.rnn = torch.nn.LSTM(SEEN, HIDDEN)
        self.head = torch.nn.Linear(HIDDEN, len(JOINTS))

    def forward(self, obs: Any, h_in: Any, c_in: Any) -> Any:
        """Return the actions and the state. `obs`: (k, 13), one robot each; (t, k, 13) in training."""
        seen, (h_out, c_out) = self.rnn(obs if obs.dim() == 3 else obs.unsqueeze(0), (h_in, c_in))
        actions = torch.tanh(self.head(seen))
        return actions if obs.dim() == 3 else actions[0], h_out, c_out


def taught(teacher: Any, mjcf: str, seed: int, rounds: int = 12, count: int = 8, steps: int = 200) -> Student:
    """Return a student that acts as its teacher. From the second round on it acts, and is corrected."""
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    student = Student()
    optimizer = torch.optim.Adam(student.parameters(), 3e-3)
    envs = [Squat(mjcf) for _ in range(count)]
    seen: list[Any] = []
    wanted: list[Any] = []
    for turn in range(rounds):
        obs = np.stack([env.reset(seed=1000 * turn + at)[0] for at, env in enumerate(envs)])
        state = torch.zeros(2, 1, count, HIDDEN).unbind()
        for _ in range(steps):
            right = teacher.predict(obs, deterministic=True)[0]
            seen.append(obs[:, :SEEN])
            wanted.append(right)
            with torch.no_grad():
                actions, *state = student(torch.from_numpy(obs[:, :SEEN]), *state)
            chosen = right if turn == 0 else actions.numpy()
            obs = np.stack([env.step(action)[0] for env, action in zip(envs, chosen, strict=True)])
        inputs = torch.from_numpy(np.stack(seen)).view(turn + 1, steps, count, SEEN)
        labels = torch.from_numpy(np.stack(wanted)).view(turn + 1, steps, count, len(JOINTS))
        for _ in range(100):
            pick = rng.integers(turn + 1)
            found = student(inputs[pick], *torch.zeros(2, 1, count, HIDDEN))[0]
            loss = torch.nn.functional.mse_loss(found, labels[pick])
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
        print(f"round {turn}: off by {float(loss.detach()) ** 0.5:.3f}")
    return student


def acting(network: torch.nn.Module, state: tuple[Any, ...], *, keep: bool = True) -> Callable[[Any], Any]:
    """Return what acts by a network, with its state (`keep`), on one observation after another."""
    memory = state

    def act(obs: Any) -> Any:
        nonlocal memory
        with torch.no_grad():
            found = network(torch.from_numpy(obs[None, :SEEN] if state else obs[None]), *memory)
        memory = tuple(found[1:]) if state and keep else state
        return (found[0] if state else found)[0].numpy()

    return act


def episode(env: Squat, act: Callable[[Any], Any]) -> tuple[dict[str, float], list[Any], list[Any]]:
    """Return error (mm, rms), return and steps of an episode, and its observations and actions."""
    obs, _ = env.reset(seed=1)
    seen: list[Any] = []
    acted: list[Any] = []
    errors: list[float] = []
    total = 0.0
    done = False
    while not done:
        seen.append(obs)
        acted.append(act(obs))
        obs, reward, fallen, over, info = env.step(acted[-1])
        errors.append(info["error"])
        total += reward
        done = fallen or over
    rms = 1e3 * float(np.sqrt(np.mean(np.square(errors))))
    return {"rms_mm": round(rms, 2), "return": round(total, 1), "steps": len(errors)}, seen, acted


def export(network: torch.nn.Module, env: Squat, path: Path, state: tuple[Any, ...]) -> dict[str, float]:
    """Write network, card and the first 100 steps of an episode as test vectors; return the figures of it."""
    size = SEEN if state else SEEN + 13
    torch.onnx.export(
        network,
        (torch.zeros(1, size), *state),
        str(path),
        input_names=["obs", "h_in", "c_in"] if state else ["obs"],
        output_names=["actions", "h_out", "c_out"] if state else ["actions"],
        opset_version=17,
        dynamo=False,
    )
    texts = {"name": path.stem, "joints": ", ".join(JOINTS), "terms": "\n      ".join(FEW if state else ALL)}
    texts["default"] = ", ".join(f"{name}: {STANCE[name[2:]]}" for name in JOINTS)
    texts["state"] = f"state: {{{STATE}}}\n" if state else ""
    path.with_suffix(".card.yaml").write_text(CARD.format(rate=RATE, scale=SCALE, period=PERIOD, **texts))
    figures, seen, acted = episode(env, acting(network, state))
    np.savez_compressed(
        path.with_suffix(".npz"), obs=np.array(seen)[:100, :size], actions=np.array(acted)[:100]
    )
    return figures


def main() -> None:
    """Train, teach, export, measure."""
    parser = argparse.ArgumentParser()
    parser.add_argument("mjcf")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--steps", type=int, default=300_000)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    torch.set_num_threads(1)
    envs = DummyVecEnv([lambda: Monitor(Squat(asked.mjcf))] * 8)
    network = {"net_arch": [64, 64], "log_std_init": -1.5}
    given: dict[str, Any] = {"n_steps": 250, "batch_size": 250, "n_epochs": 5, "learning_rate": 5e-4}
    teacher = PPO(
        "MlpPolicy",
        envs,
        policy_kwargs=network,
        gamma=0.97,
        seed=asked.seed,
        verbose=1,
        device="cpu",
        **given,
    )
    teacher.learn(asked.steps)
    asked.out.mkdir(parents=True, exist_ok=True)
    env = Squat(asked.mjcf)
    figures = {"squat": export(Actor(teacher.policy), env, asked.out / "squat.onnx", ())}
    print(json.dumps(figures))
    student = taught(teacher, asked.mjcf, asked.seed)
    zero = (torch.zeros(1, 1, HIDDEN), torch.zeros(1, 1, HIDDEN))
    figures["squat_lstm"] = export(student, env, asked.out / "squat_lstm.onnx", zero)
    figures["zero"] = episode(env, lambda obs: np.zeros(len(JOINTS)))[0]
    figures["no_memory"] = episode(env, acting(student, zero, keep=False))[0]
    print(json.dumps(figures))


if __name__ == "__main__":
    main()
