"""A policy that begins as its teacher."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("stable_baselines3", reason="make extras EXTRAS=learn")
pytest.importorskip("mink", reason="the extra walk")

from twind.learn.training.ppo_learner import PpoLearner
from twind.learn.training.training_settings import DEFAULTS


@pytest.mark.slow
def test_a_training_of_a_walk_begins_with_actions_of_the_gait_and_goes_on_from_its_checkpoint() -> None:
    from twind.learn.task.gait_reference import GaitTeacher
    from twind.learn.task.learning_tasks import WALK

    settings = replace(DEFAULTS["Walk"], envs=4, rollout=64, hidden=(64, 64), steps=1024)
    learner = PpoLearner(settings)
    env = learner.model.get_vec_normalize_env()
    core = env.venv.venv.core
    teacher = GaitTeacher(WALK, core.plant)
    seen = env.reset()
    for _ in range(80):
        seen, *_ = env.step(teacher.act(env.get_original_obs()).astype(np.float32))
    wanted = teacher.act(env.get_original_obs())
    action, _ = learner.model.predict(seen, deterministic=True)
    still = np.zeros_like(wanted)
    assert np.mean((action - wanted) ** 2) < 0.5 * np.mean((still - wanted) ** 2)
    state = learner.state()
    again = PpoLearner(settings, state)
    found, _ = again.model.predict(seen, deterministic=True)
    np.testing.assert_array_equal(found, action)
    learner.close()
    again.close()
