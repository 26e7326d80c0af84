"""Train a policy that squats in time to a clock, with Stable-Baselines3; write ONNX, card and test vectors.

    twindctl robot export h24-standing --mjcf h24/h24.xml
    python train_squat.py h24/h24.xml --out squat [--recurrent] [--steps 300000] [--seed 0]

It imports nothing of twind, but mujoco, gymnasium, stable-baselines3, sb3-contrib, torch and onnx. The body
goes 4 cm down and up in 2 s. The recurrent policy sees no velocity of a joint and only the sine of the clock,
so it must remember. The last line is JSON: error of the height (mm, rms), return and steps of the policy, of
actions of zero, and of the recurrent policy with a state that is always zero.
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
from sb3_contrib import RecurrentPPO
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv

STANCE = {"hip_pitch": -0.3, "knee": 0.6, "ankle_pitch": -0.3}  # rad
JOINTS = [f"{side}_{name}" for side in "lr" for name in STANCE]
RATE = 50  # actions per second
PERIOD = 2.0  # s, of a squat
DEPTH = 0.04  # m
SCALE = 0.6  # rad per unit of an action
SECONDS = 10  # of an episode
HIDDEN = 32
FEW = ["joint_position: {}", "base_angular_velocity: {scale: 0.25}", "projected_gravity: {}", "phase_sin: {}"]
ALL = [*FEW, "phase_cos: {}", "joint_velocity: {scale: 0.1}", "last_action: {}"]
STATE = "state: {{h_in: {{output: h_out, shape: {0}}}, c_in: {{output: c_out, shape: {0}}}}}\n"
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
action: {{output: actions, scale_rad: {scale}, clip: [-1.0, 1.0], path: linear}}
phase: {{period_s: {period}}}
test: {{file: {name}.npz, tolerance: 1.0e-4}}
"""


class Squat(gymnasium.Env[Any, Any]):
    """The exported model; six joints of the legs are moved, the others hold."""

    def __init__(self, mjcf: str, recurrent: bool) -> None:
        self.model = mujoco.MjModel.from_xml_path(mjcf)
        self.data = mujoco.MjData(self.model)
        self.substeps = round(1.0 / RATE / self.model.opt.timestep)
        self.recurrent = recurrent
        self.at = np.array([self.model.joint(name).qposadr[0] for name in JOINTS])
        self.dof = np.array([self.model.joint(name).dofadr[0] for name in JOINTS])
        self.act = np.array([self.model.actuator(name).id for name in JOINTS])
        self.default = np.array([STANCE[name[2:]] for name in JOINTS])
        self.kp = self.model.actuator_gainprm[:, 0].copy()
        self.data.qpos[self.at] = self.data.ctrl[self.act] = self.default
        mujoco.mj_step(self.model, self.data, 400)  # 2 s: it comes to rest on its feet
        self.start = self.data.qpos.copy()
        size = 13 if recurrent else 26
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (size,), np.float32)
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
        turned = self.data.body("torso").xmat.reshape(3, 3)
        gyro = 0.25 * self.data.sensor("imu_gyro").data
        parts = [self.data.qpos[self.at] - self.default, gyro, -turned[2], [np.sin(clock)]]
        if not self.recurrent:
            parts += [[np.cos(clock)], 0.1 * self.data.qvel[self.dof], self.action]
        return np.concatenate(parts).astype(np.float32)

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
        reward = float(np.exp(-((error / 0.01) ** 2))) - 5.0 * (1.0 - upright) - 0.5 * jerk - 5.0 * fallen
        return self.observe(), reward, fallen, self.steps >= SECONDS * RATE, {"error": error}


class Actor(torch.nn.Module):
    """The network that acts, without noise: what is exported."""

    def __init__(self, policy: Any) -> None:
        super().__init__()
        self.policy = policy

    def forward(self, obs: Any, h_in: Any = None, c_in: Any = None) -> Any:
        """Return the actions, and the state of a recurrent network."""
        seen = obs
        if h_in is not None:
            seen, (h_out, c_out) = self.policy.lstm_actor(obs.unsqueeze(0), (h_in, c_in))
            seen = seen.squeeze(0)
        actions = self.policy.action_net(self.policy.mlp_extractor.forward_actor(seen)).clamp(-1.0, 1.0)
        return actions if h_in is None else (actions, h_out, c_out)


def episode(env: Squat, choose: Callable[[Any], Any]) -> dict[str, float]:
    """Return error (mm, rms), return, and steps of one episode."""
    obs, _ = env.reset(seed=1)
    errors: list[float] = []
    total = 0.0
    done = False
    while not done:
        obs, reward, fallen, over, info = env.step(choose(obs))
        errors.append(info["error"])
        total += reward
        done = fallen or over
    rms = float(np.sqrt(np.mean(np.square(errors))))
    return {"rms_mm": round(1e3 * rms, 2), "return": round(total, 1), "steps": len(errors)}


def export(model: Any, env: Squat, path: Path) -> dict[str, dict[str, float]]:
    """Write network, card and test vectors; return the figures. The vectors are SB3's own predictions."""
    names = ["h_in", "c_in"] if env.recurrent else []
    state = [torch.zeros(1, 1, HIDDEN) for _ in names]
    ends = {
        "input_names": ["obs", *names],
        "output_names": ["actions", *(["h_out", "c_out"] if names else [])],
    }
    obs = torch.zeros(1, *env.observation_space.shape)
    torch.onnx.export(Actor(model.policy), (obs, *state), str(path), opset_version=17, dynamo=False, **ends)
    terms = "\n      ".join(FEW if env.recurrent else ALL)
    default = ", ".join(f"{name}: {STANCE[name[2:]]}" for name in JOINTS)
    texts = {"name": path.stem, "joints": ", ".join(JOINTS), "default": default, "terms": terms}
    card = CARD.format(rate=RATE, scale=SCALE, period=PERIOD, **texts)
    path.with_suffix(".card.yaml").write_text(card + STATE.format([1, 1, HIDDEN]) * env.recurrent)
    seen: list[Any] = []
    acted: list[Any] = []
    memory: Any = None

    def act(obs: Any) -> Any:
        nonlocal memory
        action, memory = model.predict(obs, state=memory, deterministic=True)
        seen.append(obs)
        acted.append(action)
        return action

    figures = {"policy": episode(env, act), "zero": episode(env, lambda obs: np.zeros(len(JOINTS)))}
    if env.recurrent:
        figures["no_memory"] = episode(env, lambda obs: model.predict(obs, deterministic=True)[0])
    np.savez(path.with_suffix(".npz"), obs=np.array(seen[:100]), actions=np.array(acted[:100]))
    return figures


def main() -> None:
    """Train, export, measure."""
    parser = argparse.ArgumentParser()
    parser.add_argument("mjcf")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--recurrent", action="store_true")
    parser.add_argument("--steps", type=int, default=300_000)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    torch.set_num_threads(1)
    envs = DummyVecEnv([lambda: Squat(asked.mjcf, asked.recurrent)] * 8)
    common: dict[str, Any] = {
        "n_steps": 250,
        "seed": asked.seed,
        "learning_rate": 5e-4,
        "gamma": 0.97,
        "verbose": 1,
    }
    network: dict[str, Any] = {"net_arch": [64, 64], "log_std_init": -1.5}
    if asked.recurrent:
        network |= {"net_arch": [], "lstm_hidden_size": HIDDEN}
        model: Any = RecurrentPPO(
            "MlpLstmPolicy", envs, policy_kwargs=network, batch_size=250, n_epochs=5, **common
        )
    else:
        model = PPO("MlpPolicy", envs, policy_kwargs=network, batch_size=250, n_epochs=5, **common)
    model.learn(asked.steps)
    asked.out.mkdir(parents=True, exist_ok=True)
    path = asked.out / ("squat_lstm.onnx" if asked.recurrent else "squat.onnx")
    print(json.dumps(export(model, Squat(asked.mjcf, asked.recurrent), path)))


if __name__ == "__main__":
    main()
