"""twind.learn.batch.vec_env: a batch as Stable-Baselines3 knows vector environments."""

from typing import Any

import numpy as np
import pytest

pytest.importorskip("stable_baselines3", reason="make extras EXTRAS=learn")
import gymnasium
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecMonitor

from twind.learn.batch.vec_env import BatchVecEnv

COUNT = 3
EPISODE = 12
ID = "twind.learn.envs:twind/Stand-v0"


def batch(**given: Any) -> BatchVecEnv:
    return BatchVecEnv("Stand", COUNT, episode_steps=EPISODE, threads=1, **given)


def single() -> Any:
    return gymnasium.make(ID, max_episode_steps=EPISODE)


def test_the_batch_environment_equals_a_dummy_vec_env_of_single_environments() -> None:
    one = batch()
    other = DummyVecEnv([single] * COUNT)
    assert (one.observation_space, one.action_space) == (other.observation_space, other.action_space)
    one.seed(3), other.seed(3)
    assert np.array_equal(one.reset(), other.reset())
    assert one.reset_infos == other.reset_infos
    rng = np.random.default_rng(0)
    ended = 0
    for _ in range(30):
        action = rng.uniform(-1.0, 1.0, (COUNT, 24)).astype(np.float32)
        seen = one.step(action)
        expected = other.step(action)
        for got, wanted in zip(seen[:3], expected[:3], strict=True):
            assert np.array_equal(got, wanted) and got.dtype == wanted.dtype
        for done, info, wanted in zip(seen[2], seen[3], expected[3], strict=True):
            assert info["TimeLimit.truncated"] == wanted["TimeLimit.truncated"]
            assert ("terminal_observation" in info) == done
            if done:
                ended += 1
                assert np.array_equal(info["terminal_observation"], wanted["terminal_observation"])
                assert all(info[name] == wanted[name] for name in wanted if name != "terminal_observation")
    assert ended >= 2 * COUNT
    assert one.reset_infos == other.reset_infos
    one.close(), other.close()


def test_out_of_time_is_no_fall() -> None:
    env = batch()
    env.reset()
    for _ in range(EPISODE):
        _, _, done, infos = env.step(np.zeros((COUNT, 24), np.float32))
    assert done.all() and all(info["TimeLimit.truncated"] for info in infos)


def test_seeds_and_options_are_used_once() -> None:
    env = batch(randomise="default")
    env.seed(1)
    env.set_options({"command": (0.1, 0.0, 0.0)})
    first = env.reset()
    assert [info["command"] for info in env.reset_infos] == [(0.1, 0.0, 0.0)] * COUNT
    assert not np.array_equal(env.reset(), first)
    env.seed(1)
    env.set_options({"command": (0.1, 0.0, 0.0)})
    assert np.array_equal(env.reset(), first)
    env.set_options([{"command": (0.1, 0.0, 0.0)}, {}, {}])
    with pytest.raises(ValueError, match="one command for all"):
        env.reset()


def test_shared_attributes_can_be_read_and_none_can_be_set() -> None:
    env = batch()
    assert env.get_attr("render_mode") == [None] * COUNT
    assert env.get_attr("episode_steps", indices=[0, 2]) == [EPISODE] * 2
    assert env.env_is_wrapped(VecMonitor) == [False] * COUNT
    for wrong in (lambda: env.get_attr("wings"), lambda: env.set_attr("a", 1), lambda: env.env_method("fly")):
        with pytest.raises(AttributeError):
            wrong()


def test_single_environments_run_in_processes_of_their_own_too() -> None:
    with_processes = SubprocVecEnv([single] * 2)
    alone = DummyVecEnv([single] * 2)
    try:
        with_processes.seed(2), alone.seed(2)
        assert np.array_equal(with_processes.reset(), alone.reset())
        for _ in range(EPISODE + 1):
            action = np.full((2, 24), 0.1, np.float32)
            assert np.array_equal(with_processes.step(action)[0], alone.step(action)[0])
    finally:
        with_processes.close()
