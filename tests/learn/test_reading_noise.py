"""twind.learn.randomise.reading_noise: noise on readings, each quantity by its own range."""

from dataclasses import fields, replace

import numpy as np
import pytest

from twind.learn.observation import BodyReading
from twind.learn.randomise.randomisation_ranges import NoiseRanges
from twind.learn.randomise.reading_noise import ReadingNoise

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


def test_noise_lies_evenly_around_the_truth() -> None:
    reading = readings(2000)
    ReadingNoise(NoiseRanges(position=0.1), JOINTS, 2000).add(reading, generators(2000))
    assert abs(reading.position.mean()) < 0.003
    assert reading.position.std() == pytest.approx(0.1 / np.sqrt(3.0), rel=0.03)


def test_one_robot_alone_has_the_noise_that_it_has_among_many() -> None:
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
