"""twind.learn.randomise.disturbances: pushes of the base, and noise on the readings."""

from dataclasses import fields, replace
from itertools import groupby

import numpy as np
import pytest

from twind.learn.randomise.disturbances import PushSchedule, ReadingNoise
from twind.learn.randomise.randomisation_ranges import NoiseRanges, PushRanges
from twind.learn.task.observation import BodyReading
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


def test_pushes_and_pauses_are_in_their_ranges() -> None:
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


def test_a_push_step_reports_a_change_exactly_when_the_force_changes() -> None:
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


JOINTS = 3


def readings(count: int) -> BodyReading:
    reading = BodyReading.empty(JOINTS, (count,))
    reading.gravity[..., 2] = -1.0
    return reading


def generators(count: int, seed: int = 0) -> list[np.random.Generator]:
    return [np.random.default_rng(seed + each) for each in range(count)]


@pytest.mark.parametrize("quantity", [each.name for each in fields(NoiseRanges)])
def test_noise_on_a_quantity_touches_nothing_else(quantity: str) -> None:
    noise = ReadingNoise(replace(NoiseRanges(), **{quantity: 0.3}), JOINTS, 200)
    reading = readings(200)
    clean = readings(200)
    noise.add(reading, generators(200))
    for each in fields(NoiseRanges):
        off = np.abs(getattr(reading, each.name) - getattr(clean, each.name))
        if each.name != quantity:
            assert not off.any(), each.name
        elif quantity != "gravity":
            assert 0.29 < off.max() <= 0.3
        else:
            assert 0.2 < off.max() < 0.6


def test_gravity_stays_a_unit_vector() -> None:
    reading = readings(50)
    ReadingNoise(NoiseRanges(gravity=0.2), JOINTS, 50).add(reading, generators(50))
    assert np.linalg.norm(reading.gravity, axis=-1) == pytest.approx(np.ones(50))


def test_noise_is_uniform_around_the_true_value() -> None:
    reading = readings(2000)
    ReadingNoise(NoiseRanges(position=0.1), JOINTS, 2000).add(reading, generators(2000))
    assert abs(reading.position.mean()) < 0.003
    assert reading.position.std() == pytest.approx(0.1 / np.sqrt(3.0), rel=0.03)


def test_a_single_robot_has_the_same_noise_as_in_a_batch() -> None:
    ranges = NoiseRanges(position=0.1, gravity=0.1, sole_velocities=0.2)
    many = readings(4)
    alone = BodyReading.empty(JOINTS)
    alone.gravity[2] = -1.0
    ReadingNoise(ranges, JOINTS, 4).add(many, generators(4))
    ReadingNoise(ranges, JOINTS).add(alone, generators(4)[2:3])
    assert np.array_equal(many.values[2], alone.values)


def test_no_noise_draws_no_random_number() -> None:
    rng = np.random.default_rng(0)
    before = rng.bit_generator.state
    reading = readings(1)
    ReadingNoise(NoiseRanges(), JOINTS).add(reading, [rng])
    assert rng.bit_generator.state == before
    assert np.array_equal(reading.values, readings(1).values)
