"""twind.learn.randomise.push_schedule: how hard, how long and how often something pushes the robot."""

from itertools import groupby

import numpy as np
import pytest

from twind.learn.randomise.push_schedule import PushSchedule
from twind.learn.randomise.randomisation_ranges import PushRanges
from twind.robot.arrays import Floats

MASS = 4.0
PERIOD = 0.02
RANGES = PushRanges(every=(1.0, 2.0), speed=(0.1, 0.3), lasting=(0.06, 0.2))


def pushed(steps: int, seed: int = 0, ranges: PushRanges | None = RANGES) -> Floats:
    """(steps, 2) N: one robot's episode."""
    rngs = [np.random.default_rng(seed)]
    pushes = PushSchedule(ranges, MASS, PERIOD)
    pushes.begin([0], rngs)
    forces = []
    for _ in range(steps):
        pushes.step(rngs)
        forces.append(pushes.force[0].copy())
    return np.array(forces)


def runs(forces: Floats) -> list[tuple[bool, Floats]]:
    """Pauses and pushes in their order; the last one may be cut short and is left out."""
    marked = groupby(forces, key=lambda force: bool(force.any()))
    return [(active, np.array(list(group))) for active, group in marked][:-1]


def test_pushes_and_pauses_lie_in_their_ranges() -> None:
    found = runs(pushed(20_000))
    pauses = [len(run) * PERIOD for active, run in found if not active]
    pushes = [run for active, run in found if active]
    assert len(pushes) > 200
    assert 1.0 <= min(pauses) < 1.05 and 1.95 < max(pauses) <= 2.0 + 1e-9
    lasting = [len(run) * PERIOD for run in pushes]
    assert min(lasting) == pytest.approx(0.06) and max(lasting) == pytest.approx(0.2)
    gained = [float(np.linalg.norm(run.sum(axis=0)) * PERIOD / MASS) for run in pushes]
    assert 0.1 <= min(gained) < 0.11 and 0.29 < max(gained) <= 0.3


def test_a_push_keeps_its_force_and_comes_from_anywhere() -> None:
    pushes = [run for active, run in runs(pushed(20_000)) if active]
    assert all((run == run[0]).all() for run in pushes)
    quadrants = {tuple(np.sign(run[0]).astype(int).tolist()) for run in pushes}
    assert quadrants == {(1, 1), (1, -1), (-1, 1), (-1, -1)}


def test_a_change_is_told_when_it_is_one() -> None:
    rngs = [np.random.default_rng(1)]
    pushes = PushSchedule(RANGES, MASS, PERIOD)
    pushes.begin([0], rngs)
    before = pushes.force.copy()
    for _ in range(1000):
        changed = pushes.step(rngs)
        assert changed == (not np.array_equal(before, pushes.force))
        before = pushes.force.copy()


def test_each_robot_is_pushed_as_it_would_be_alone() -> None:
    rngs = [np.random.default_rng(seed) for seed in (5, 6)]
    pushes = PushSchedule(RANGES, MASS, PERIOD, 2)
    pushes.begin([0, 1], rngs)
    forces = []
    for _ in range(500):
        pushes.step(rngs)
        forces.append(pushes.force.copy())
    assert np.array_equal(np.array(forces)[:, 0], pushed(500, 5))
    assert np.array_equal(np.array(forces)[:, 1], pushed(500, 6))


def test_a_new_episode_begins_without_a_push() -> None:
    rngs = [np.random.default_rng(0)]
    pushes = PushSchedule(RANGES, MASS, PERIOD)
    pushes.begin([0], rngs)
    while not pushes.force.any():
        pushes.step(rngs)
    pushes.begin([0], rngs)
    assert not pushes.force.any()
    assert not any(pushes.step(rngs) for _ in range(49))


def test_without_pushes_nothing_is_drawn() -> None:
    assert not pushed(1000, ranges=None).any()
    rng = np.random.default_rng(0)
    before = rng.bit_generator.state
    PushSchedule(None, MASS, PERIOD).begin([0], [rng])
    assert rng.bit_generator.state == before


def test_pushes_without_force_keep_their_times_too() -> None:
    soft = PushRanges(every=(1.0, 1.0), speed=(0.0, 0.0), lasting=(0.1, 0.1))
    rngs = [np.random.default_rng(0)]
    pushes = PushSchedule(soft, MASS, PERIOD)
    pushes.begin([0], rngs)
    assert [step for step in range(170) if pushes.step(rngs)] == [50, 55, 105, 110, 160, 165]
