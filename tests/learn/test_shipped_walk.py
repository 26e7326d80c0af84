"""The policy that comes with h24-standing walks as it is asked to."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("gymnasium", reason="make extras EXTRAS=learn")
pytest.importorskip("mink", reason="the extra walk")

from twind import robots
from twind.learn.batch.batch_core import BatchCore
from twind.learn.policy.policy_file import read
from twind.learn.task.learning_tasks import WALK

FILE = Path(robots.__file__).with_name("h24-standing.walk.onnx")
LARGEST = 1_000_000  # bytes
PERIOD = WALK.shaping.period


def walked(
    speed: float, seconds: float, seeds: range, randomise: str | None
) -> tuple[np.ndarray, np.ndarray]:
    """Distance along the robot's own front, m, and whether it fell, of each seed."""
    count = len(seeds)
    core = BatchCore(
        "Walk",
        count,
        robot="h24-standing",
        randomise=randomise,
        episode_steps=round(seconds / PERIOD) + 1,
    )
    core.seed(list(seeds))
    observation = core.reset(command=(speed, 0.0, 0.0))
    act = read(FILE.read_bytes()).act
    way = np.zeros(count)
    fallen = np.zeros(count, np.bool_)
    for _ in range(round(seconds / PERIOD)):
        step = core.step(act(observation))
        observation = step.observation
        fallen |= step.fallen
        way += ~fallen * core.body.reading.base_velocity[:, 0] * PERIOD
    return way, fallen


def test_it_walks_and_its_file_is_small() -> None:
    way, fallen = walked(0.15, 8.0, range(2), None)
    assert not fallen.any()
    assert (way > 0.6).all()
    assert FILE.stat().st_size < LARGEST


def test_a_command_of_zero_leaves_it_standing() -> None:
    way, fallen = walked(0.0, 4.0, range(2), None)
    assert not fallen.any()
    assert (np.abs(way) < 0.1).all()


@pytest.mark.campaign
@pytest.mark.parametrize("randomise", [None, "walk"])
def test_it_walks_five_metres_at_the_commanded_speed(randomise: str | None) -> None:
    way, fallen = walked(0.15, 40.0, range(100, 110), randomise)
    print(f"{randomise}: {np.round(way, 2)}, {fallen.sum()} of {len(fallen)} fell")
    assert fallen.sum() == 0
    assert (way >= 5.0).all()
