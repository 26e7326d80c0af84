"""twind.learn.batch.vector_env: a batch as Gymnasium knows vector environments."""

from typing import Any

import numpy as np
import pytest

pytest.importorskip("gymnasium", reason="make extras EXTRAS=learn")
import gymnasium
from gymnasium.vector import AutoresetMode

from twind.exceptions import OperationFailed

ID = "twind.learn.envs:twind/Stand-v0"
COUNT = 3


def made(**given: Any) -> Any:
    return gymnasium.make_vec(ID, num_envs=COUNT, **given)


def one_by_one() -> Any:
    """The same environments, each in its turn: Gymnasium's own vector environment."""
    return gymnasium.make_vec(
        ID,
        num_envs=COUNT,
        vectorization_mode="sync",
        vector_kwargs={"autoreset_mode": AutoresetMode.SAME_STEP},
        max_episode_steps=12,
    )


def same(one: Any, other: Any) -> bool:
    """The same answer, down to the last key and value of its info."""
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if isinstance(one, np.ndarray) and one.dtype == object:
        return all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))
    return np.array_equal(one, other)


def test_the_batch_equals_a_gymnasium_sync_vector_environment() -> None:
    batch = made(max_episode_steps=12)
    assert batch.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    sync = one_by_one()
    assert batch.observation_space == sync.observation_space and batch.action_space == sync.action_space
    assert batch.single_observation_space == sync.single_observation_space
    assert same(batch.reset(seed=5)[0], sync.reset(seed=5)[0])
    batch.action_space.seed(1)
    ended = 0
    for _ in range(30):
        action = batch.action_space.sample()
        one = batch.step(action)
        other = sync.step(action)
        assert all(
            np.array_equal(a, b) and a.dtype == b.dtype for a, b in zip(one[:4], other[:4], strict=True)
        )
        masks = {key for key in other[4] if key.startswith("_")}
        assert one[4].keys() == other[4].keys()
        assert all(np.array_equal(one[4][key], other[4][key]) for key in masks - {"_final_info"})
        if "final_obs" in other[4]:
            ended += int(other[4]["_final_obs"].sum())
            assert same(one[4]["final_obs"], other[4]["final_obs"])
            whose = other[4]["_final_info"]
            for name, values in other[4]["final_info"].items():
                assert np.array_equal(one[4]["final_info"][name][whose], values[whose])
    assert ended >= 2 * COUNT
    batch.close(), sync.close()


def test_returned_arrays_are_not_overwritten_by_later_steps() -> None:
    env = made()
    seen, _ = env.reset(seed=0)
    kept = seen.copy()
    one = env.step(np.zeros((COUNT, env.core.joints), np.float32))
    copies = [np.array(part) for part in one[:4]]
    env.step(np.ones((COUNT, env.core.joints), np.float32))
    assert np.array_equal(seen, kept)
    assert all(np.array_equal(part, copy) for part, copy in zip(one[:4], copies, strict=True))


def test_each_robot_may_have_its_own_seed_and_some_alone_may_begin_anew() -> None:
    env = made(randomise="default")
    first, _ = env.reset(seed=[4, 4, 5])
    assert np.array_equal(first[0], first[1]) and not np.array_equal(first[0], first[2])
    seen, info = env.reset(seed=4, options={"reset_mask": np.array([False, False, True])})
    assert np.array_equal(seen[:2], first[:2]) and not np.array_equal(seen[2], first[2])
    assert info["_command"].tolist() == [False, False, True]
    for wrong in ({"seed": [1, 2]}, {"options": {"reset_mask": np.array([True])}}):
        with pytest.raises(ValueError, match="for 3 environments"):
            env.reset(**wrong)  # type: ignore[arg-type]


def test_a_robot_behind_its_daemon_is_one_environment_and_no_batch() -> None:
    with pytest.raises(ValueError, match="one robot is one environment: `make`"):
        made(backend="daemon")


def test_wrappers_of_gymnasium_count_its_episodes() -> None:
    env = gymnasium.wrappers.vector.RecordEpisodeStatistics(made(max_episode_steps=10))
    env.reset(seed=0)
    lengths = []
    for _ in range(21):
        info = env.step(np.zeros((COUNT, env.unwrapped.core.joints), np.float32))[4]
        if "episode" in info:
            lengths += info["episode"]["l"][info["_episode"]].tolist()
    assert lengths == [10] * (2 * COUNT)


def test_a_render_mode_that_there_is_not_is_refused() -> None:
    with pytest.raises(ValueError, match="render_mode 'human'"):
        made(render_mode="human")


def test_batch_pictures_equal_those_of_single_environments() -> None:
    assert made().render() is None
    batch = made(render_mode="rgb_array")
    alone = gymnasium.make(ID, render_mode="rgb_array")
    batch.reset(seed=0), alone.reset(seed=1)
    action = np.ones((COUNT, batch.core.joints), np.float32)
    for _ in range(4):
        batch.step(action), alone.step(action[0])
    try:
        expected = alone.render()
    except OperationFailed as reason:
        pytest.skip(str(reason))
    pictures = batch.render()
    assert len(pictures) == COUNT and pictures[1].std() > 10.0
    assert np.array_equal(pictures[1], expected) and not np.array_equal(pictures[0], expected)
    batch.close(), batch.close(), alone.close()
