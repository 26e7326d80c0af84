"""The environments: what Gymnasium and SB3 ask of them, and what a learner may rely on."""

from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

pytest.importorskip("gymnasium", reason="make extras EXTRAS=learn")

import gymnasium
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env

from twind.exceptions import OperationFailed
from twind.learn.environment.camera_renderer import CameraRenderer
from twind.learn.environment.robot_env import RobotEnv
from twind.learn.task.action_shaping import ActionShaping

NAMES = ("Stand", "Humanoid")


def make(name: str, **options: Any) -> Any:
    return gymnasium.make(f"twind.learn.envs:twind/{name}-v0", **options)


@pytest.fixture
def env() -> Iterator[RobotEnv]:
    made = RobotEnv("Stand")
    yield made
    made.close()


@pytest.mark.parametrize("name", NAMES)
def test_gymnasium_s_own_checker_finds_nothing(name: str) -> None:
    """Warnings are errors here."""
    env = make(name)
    check_env(env.unwrapped, skip_render_check=True)
    env.close()


@pytest.mark.parametrize("name", NAMES)
def test_sb3_s_own_checker_finds_nothing(name: str) -> None:
    checker = pytest.importorskip("stable_baselines3.common.env_checker", reason="make extras EXTRAS=learn")
    env = make(name)
    checker.check_env(env)
    env.close()


@pytest.mark.parametrize("name", NAMES)
def test_random_actions_give_finite_numbers_within_the_spaces(name: str) -> None:
    env = make(name)
    env.action_space.seed(1)
    observation, _ = env.reset(seed=1)
    ends = 0
    for _ in range(400):
        assert observation in env.observation_space
        observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        assert np.isfinite(reward) and reward == pytest.approx(sum(info.values()))
        if terminated or truncated:
            ends += 1
            observation, _ = env.reset()
    assert ends > 1, "random actions make it fall"
    env.close()


def test_no_action_stands_for_a_while_and_a_push_fells_it(env: RobotEnv) -> None:
    env.reset(seed=0)
    for _ in range(25):
        _, reward, fallen, *_ = env.step(np.zeros(24))
        assert not fallen and reward > 0.0
    env.body.data.qvel[0] += 2.0
    for _ in range(100):
        *_, fallen, _, _ = env.step(np.zeros(24))
        if fallen:
            return
    pytest.fail("pushed with 2 m/s it still stands")


def test_nothing_that_was_returned_changes_later(env: RobotEnv) -> None:
    rng = np.random.default_rng(0)
    returned = [env.reset(seed=0)[0]]
    infos = []
    for _ in range(5):
        observation, *_, info = env.step(rng.uniform(-1, 1, 24))
        returned.append(observation)
        infos.append(info)
    for one, other in pairwise(returned):
        assert not np.shares_memory(one, other)
    assert len({id(info) for info in infos}) == 5


def test_an_episode_ends_by_its_time_whatever_its_period() -> None:
    assert RobotEnv("Humanoid").episode_steps == 1000
    slow = make("Humanoid", shaping=ActionShaping(period=0.1)).unwrapped
    assert slow.metadata["render_fps"] == 10
    slow.reset(seed=0)
    for step in range(1, 201):
        *_, terminated, truncated, _ = slow.step(np.zeros(24, np.float32))
        assert not terminated, "with no pushes no action stands"
        assert truncated is (step == 200)
    short = make("Humanoid", episode_steps=3)
    short.reset(seed=0)
    assert [short.step(np.zeros(24, np.float32))[3] for _ in range(3)] == [False, False, True]


def test_a_step_before_any_reset_is_an_error(env: RobotEnv) -> None:
    with pytest.raises(ResetNeeded, match="no episode has begun"):
        env.step(np.zeros(24))
    assert env.body.data.time == 0.0


def test_a_command_may_be_given(env: RobotEnv) -> None:
    walking = RobotEnv("Humanoid")
    observation, info = walking.reset(seed=0, options={"command": (0.25, 0.1, -0.2)})
    np.testing.assert_allclose(
        observation[walking.plant.layout.places["command"]], (0.25, 0.1, -0.2), rtol=1e-6
    )
    assert info == {"command": (0.25, 0.1, -0.2)}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"command": (np.nan, 0.0, 0.0)}, r"command \(nan, 0.0, 0.0\): three numbers are needed"),
        ({"command": (0.1, 0.0, 5.5)}, r"each within ±5"),
        ({"command": 5}, "command 5: three numbers"),
        ({"command": (1.0, 2.0)}, r"command \(1.0, 2.0\): three numbers"),
        ({"command": "left"}, "command 'left': three numbers"),
        ({"comand": (0.1, 0.0, 0.0)}, "option 'comand': command"),
    ],
)
def test_an_invalid_reset_option_is_refused_and_changes_nothing(
    options: dict[str, Any], message: str
) -> None:
    one = RobotEnv("Humanoid")
    many = gymnasium.make_vec("twind.learn.envs:twind/Humanoid-v0", num_envs=2)
    for env in (one, many):
        env.reset(seed=0, options={"command": (0.3, 0.0, 0.0)})
        before = env.step(env.action_space.sample() * 0)[0]
        with pytest.raises(ValueError, match=message):
            env.reset(seed=1, options=options)
        after = env.step(env.action_space.sample() * 0)[0]
        at = one.plant.layout.places["command"]
        np.testing.assert_array_equal(after[..., at], before[..., at])


def test_a_robot_gets_no_artificial_noise() -> None:
    with pytest.raises(ValueError, match="randomise 'default' with backend 'daemon': it is of simulations"):
        RobotEnv("Stand", robot="h24-standing", backend="daemon", randomise="default", socket="/nowhere")


def test_an_action_with_nan_is_refused_before_the_simulation_steps(env: RobotEnv) -> None:
    env.reset(seed=0)
    told = env.body.data.ctrl.copy()
    one = np.zeros(24)
    one[3] = np.nan
    with pytest.raises(ValueError, match="is not all numbers"):
        env.step(one)
    np.testing.assert_array_equal(env.body.data.ctrl, told)
    assert env.body.data.time == 0.0
    env.reset()
    assert np.isfinite(env.step(np.zeros(24))[0]).all()


def test_a_diverged_simulation_ends_the_episode_and_is_reported(env: RobotEnv) -> None:
    env.reset(seed=0)
    env.body.data.qvel[8] = 1e12
    *_, terminated, _, info = env.step(np.zeros(24))
    assert terminated is True and info["diverged"] is True
    observation, _ = env.reset()
    assert np.isfinite(observation).all() and env.step(np.zeros(24))[2] is False


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"render_mode": "human"}, "None or 'rgb_array'"),
        ({"backend": "real"}, "backend 'real': sim or daemon"),
        ({"task": "Fly"}, "no task 'Fly'"),
        ({"robot": "nobody"}, "no robot of that name"),
    ],
)
def test_an_invalid_environment_option_is_refused(wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(Exception, match=message):
        RobotEnv(**{"task": "Stand", **wrong})


def test_a_picture_shows_the_robot() -> None:
    env = RobotEnv("Stand", render_mode="rgb_array")
    env.reset(seed=0)
    try:
        probe = CameraRenderer(env.body.model, "torso")
    except OperationFailed as reason:
        pytest.skip(str(reason))
    probe.close()
    picture = env.render()
    assert picture is not None and picture.shape == (480, 640, 3) and picture.dtype == np.uint8
    middle = picture[120:360, 260:380].reshape(-1, 3)
    corner = picture[:100, :100].reshape(-1, 3)
    assert middle.std() > 30.0 > corner.std(), "a light robot in the middle, nothing in the sky"
    env.body.data.qpos[3:7] = 0.7, 0.7, 0.0, 0.0
    for _ in range(3):
        env.step(np.zeros(24))
    assert (env.render() != picture).any()
    env.close()
    env.close()
    assert RobotEnv("Stand").render() is None
