"""A reading becomes an observation: for one robot and for many the same."""

import numpy as np
import pytest

from twind.learn.task.observation import BodyReading, ObservationBuilder, height_of
from twind.learn.task.observation_layout import ObservationLayout

JOINTS = ("a", "b", "c")
LAYOUT = ObservationLayout(JOINTS)
DEFAULT = np.array([0.1, -0.2, 0.3])


def reading(shape: tuple[int, ...] = ()) -> BodyReading:
    """Every number another one."""
    values = np.random.default_rng(4).uniform(-0.9, 0.9, (*shape, 2 * 3 + 25))
    return BodyReading(values)


def observe(known: BodyReading, shape: tuple[int, ...] = ()) -> np.ndarray:
    rng = np.random.default_rng(5)
    action = rng.uniform(-1, 1, (*shape, 3))
    target = rng.uniform(-1, 1, (*shape, 3))
    command = rng.uniform(-1, 1, (*shape, 3))
    phase = rng.uniform(-1, 1, (*shape, 4))
    return ObservationBuilder(LAYOUT, DEFAULT, shape).observe(known, action, target, command, phase)


def test_each_quantity_is_at_its_place_in_the_layout() -> None:
    known = reading()
    at = LAYOUT.places
    action = np.ones(3) * 0.5
    target = np.ones(3) * 0.25
    command = np.array([0.1, 0.2, 0.3])
    phase = np.ones(4) * 0.7
    seen = ObservationBuilder(LAYOUT, DEFAULT).observe(known, action, target, command, phase)
    assert seen.dtype == np.float32
    expected = {
        "position": known.position - DEFAULT,
        "velocity": known.velocity,
        "action": action,
        "lag": target - known.position,
        "gyro": known.gyro,
        "acceleration": known.acceleration,
        "gravity": known.gravity,
        "height": known.height,
        "base_velocity": known.base_velocity,
        "soles": known.soles.ravel(),
        "sole_velocities": known.sole_velocities.ravel(),
        "command": command,
        "phase": phase,
    }
    assert set(expected) == set(at) - {"base"}
    for name, value in expected.items():
        np.testing.assert_allclose(seen[at[name]], value, rtol=1e-6, err_msg=name)


def test_many_robots_are_observed_as_each_alone() -> None:
    many = reading((4,))
    together = observe(many, (4,))
    rng = np.random.default_rng(5)
    action = rng.uniform(-1, 1, (4, 3))
    target = rng.uniform(-1, 1, (4, 3))
    command = rng.uniform(-1, 1, (4, 3))
    phase = rng.uniform(-1, 1, (4, 4))
    observer = ObservationBuilder(LAYOUT, DEFAULT)
    for i in range(4):
        alone = observer.observe(BodyReading(many.values[i]), action[i], target[i], command[i], phase[i])
        np.testing.assert_array_equal(together[i], alone)


def test_an_observation_is_a_new_array_each_time() -> None:
    observer = ObservationBuilder(LAYOUT, DEFAULT)
    known = reading()
    nothing = np.zeros(4)
    first = observer.observe(known, DEFAULT, DEFAULT, nothing[:3], nothing)
    kept = first.copy()
    second = observer.observe(BodyReading.empty(3), DEFAULT, DEFAULT, nothing[:3], nothing)
    assert not np.shares_memory(first, second)
    np.testing.assert_array_equal(first, kept)


def test_a_value_beyond_the_bounds_is_clipped_and_nan_stays() -> None:
    known = BodyReading.empty(3)
    known.gyro[...] = 1e6, -1e6, np.nan
    gyro = observe(known)[LAYOUT.places["gyro"]]
    assert gyro[:2].tolist() == [35.0, -35.0]
    assert np.isnan(gyro[2])


def test_the_names_of_a_reading_are_views_of_one_buffer() -> None:
    known = BodyReading.empty(3)
    for name in BodyReading.__slots__:
        assert np.shares_memory(getattr(known, name), known.values), name
    known.height[...] = 0.4
    assert np.count_nonzero(known.values) == 1


def test_a_buffer_of_another_size_is_no_reading() -> None:
    with pytest.raises(ValueError, match="2n \\+ 25"):
        BodyReading(np.zeros(26))


def test_height_is_counted_from_the_lower_sole_along_gravity() -> None:
    known = BodyReading.empty(3)
    known.gravity[...] = 0.6, 0.0, -0.8
    known.soles[...] = [0.0, 0.1, -0.5], [0.1, -0.1, -0.4]
    assert height_of(known.base) == pytest.approx(0.4)
    known.soles[1] = 0.3, 0.0, -0.4
    assert height_of(known.base) == pytest.approx(0.5)
