"""twind.learn.batch.batch_core: many robots are what each would be alone; episodes end and begin in one
step."""

from typing import Any

import numpy as np
import pytest

pytest.importorskip("gymnasium", reason="make extras EXTRAS=learn")
from mujoco.batch import SimulationError

from twind.learn.batch import batch_body
from twind.learn.batch.batch_core import BatchCore, BatchStep
from twind.learn.environment.robot_env import RobotEnv

COUNT = 3
EPISODE = 40


def core(**given: Any) -> BatchCore:
    """Robots of a robot file, their episodes cut short."""
    made = BatchCore("Stand", COUNT, episode_steps=EPISODE, **given)
    made.seed([20 + each for each in range(COUNT)])
    return made


def actions(steps: int, joints: int) -> Any:
    """(steps, COUNT, n): gentle ones at first, then such that throw the robot over."""
    rng = np.random.default_rng(7)
    gentle = rng.uniform(-0.2, 0.2, (steps, COUNT, joints))
    wild = rng.choice([-1.0, 1.0], (COUNT, joints))
    return np.where(np.arange(steps)[:, None, None] < steps // 2, gentle, wild)


@pytest.mark.parametrize(
    ("task", "randomise"), [("Stand", None), ("Stand", "default"), ("Humanoid", "default")]
)
def test_a_robot_of_a_batch_is_what_it_is_alone_bit_for_bit(task: str, randomise: str | None) -> None:
    many = BatchCore(task, COUNT, episode_steps=EPISODE, randomise=randomise, threads=2)
    many.seed([20 + each for each in range(COUNT)])
    first = many.reset()
    alone = [RobotEnv(task, randomise=randomise) for _ in range(COUNT)]
    for each, env in enumerate(alone):
        assert np.array_equal(env.reset(seed=20 + each)[0], first[each])
    age = np.zeros(COUNT, int)
    ends = {"fallen": 0, "out of time": 0}
    for action in actions(150, many.joints):
        step = many.step(action)
        age += 1
        for each, env in enumerate(alone):
            seen, reward, fallen, _, terms = env.step(action[each])
            late = bool(age[each] == EPISODE)
            assert (reward, fallen, late) == (step.reward[each], step.fallen[each], step.truncated[each])
            assert all(terms[name] == step.terms[name][each] for name in terms)
            if fallen or late:
                last = step.last[step.ended.tolist().index(each)]
                assert np.array_equal(last, seen)  # the last one of the old episode ...
                # ... and the first one of the new
                seen = env.reset()[0]
                age[each] = 0
                ends["fallen" if fallen else "out of time"] += 1
            assert np.array_equal(step.observation[each], seen)
    assert min(ends.values()) > 0, ends


@pytest.mark.parametrize("randomise", [None, "default"])
def test_the_first_imu_reading_is_that_of_a_robot_at_rest(randomise: str | None) -> None:
    """Not of one in free fall: nobody who holds a robot lets go of it as its policy begins."""
    many = BatchCore("Stand", 8, randomise=randomise, threads=1)
    many.seed(list(range(8)))
    many.reset()
    reading = many.body.reading
    noise = 1.0 if randomise else 1e-9  # m/s²
    np.testing.assert_allclose(reading.acceleration, -9.81 * reading.gravity, atol=noise)


def test_the_same_seeds_give_the_same_episodes_and_others_do_not() -> None:
    def run(first: int) -> Any:
        made = BatchCore("Stand", COUNT, randomise="default", threads=1)
        made.seed([first + each for each in range(COUNT)])
        made.reset()
        return np.array([made.step(action[:1]).observation for action in actions(9, made.joints)])

    assert np.array_equal(run(1), run(1))
    assert not np.array_equal(run(1)[:, 0], run(2)[:, 0])
    assert np.array_equal(run(1)[:, 1], run(2)[:, 0])


def test_whether_simulations_are_kept_between_steps_changes_no_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    def run() -> Any:
        made = core(randomise="default", threads=2)
        made.reset()
        return made.body.batch.persistent, [made.step(action).observation for action in actions(100, 24)]

    kept, first = run()
    monkeypatch.setattr(batch_body, "KEPT", 0)
    fresh, second = run()
    assert kept and not fresh
    assert np.array_equal(first, second)


def test_each_robot_is_drawn_anew_with_each_episode() -> None:
    made = core(randomise="default", threads=1)
    made.reset()
    masses = made.body.batch.expanded("body_mass")
    first = masses.copy()
    made.reset(np.array([1]))
    changed = (masses != first).any(axis=1)
    assert changed.tolist() == [False, True, False]
    assert len(np.unique(masses[:, 1])) == COUNT


def test_without_randomisation_the_model_is_shared_by_all() -> None:
    made = core(threads=1)
    made.reset()
    assert made.body.batch.expanded("body_mass") is None
    assert made.body.batch.expanded("geom_friction") is None


def test_only_the_robots_that_are_asked_for_begin_anew() -> None:
    made = core(threads=1)
    made.reset()
    for action in actions(6, made.joints):
        before = made.step(action).observation
    after = made.reset(np.array([0, 2]))
    assert np.array_equal(after[1], before[1])
    assert not np.array_equal(after[0], before[0]) and not np.array_equal(after[2], before[2])


def broken(made: BatchCore, at: int) -> BatchStep:
    """The step in which robot `at` has a speed that no physics can follow."""
    made.body.batch.qvel[at, 8] = 1e13
    return made.step(np.zeros((COUNT, made.joints)))


@pytest.mark.parametrize("steps", [0, 4])
def test_a_simulation_that_breaks_down_ends_its_episode_and_begins_anew(steps: int) -> None:
    made = core(threads=1)
    intact = core(threads=1)
    made.reset(), intact.reset()
    for _ in range(steps):
        made.step(np.zeros((COUNT, made.joints))), intact.step(np.zeros((COUNT, made.joints)))
    step = broken(made, 1)
    other = intact.step(np.zeros((COUNT, made.joints)))
    assert step.fallen.tolist() == [False, True, False]
    assert step.terms["diverged"].tolist() == [False, True, False]
    assert np.isfinite(step.observation).all() and np.isfinite(step.reward).all()
    assert step.ended.tolist() == [1]
    for each in (0, 2):  # the others do not notice
        assert np.array_equal(step.observation[each], other.observation[each])
    following = made.step(np.zeros((COUNT, made.joints)))
    assert not following.fallen.any()


def test_a_simulation_error_ends_its_episode(monkeypatch: pytest.MonkeyPatch) -> None:
    made = core(threads=1)
    made.reset()
    batch = made.body.batch
    real = batch.step

    def step(**given: Any) -> None:
        real(**given)
        raise SimulationError(np.array([2], np.int32), "no memory")

    with monkeypatch.context() as patch:
        patch.setattr(batch, "step", step)
        failed = made.step(np.zeros((COUNT, made.joints)))
    assert failed.fallen.tolist() == [False, False, True] and failed.ended.tolist() == [2]
    assert not made.step(np.zeros((COUNT, made.joints))).fallen.any()


def test_a_nan_action_raises_an_error_with_its_robot_and_moves_no_robot() -> None:
    made = core(threads=1)
    made.reset()
    action = np.zeros((COUNT, made.joints))
    action[1, 3] = np.nan
    before = made.body.batch.qpos.copy()
    with pytest.raises(ValueError, match=r"robots \[1\]: an action is not all numbers"):
        made.step(action)
    assert np.array_equal(made.body.batch.qpos, before)


def test_a_batch_of_zero_environments_is_refused() -> None:
    with pytest.raises(ValueError, match="0 environments: at least one is needed"):
        BatchCore("Stand", 0)


def test_a_command_that_is_given_is_that_of_all() -> None:
    made = core(threads=1)
    seen = made.reset(command=(0.1, 0.0, -0.2))
    assert np.allclose(seen[:, made.plant.layout.places["command"]], [0.1, 0.0, -0.2])
