"""Figures of a step against motions whose figures are known."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twind.exceptions import InvalidInput
from twind.robot.arrays import Floats
from twind.tuning.step_response import SHARE, WATCH, StepResponse, measure_steps, step_motion

PERIOD = 0.001


def oscillator(damping: float, frequency: float = 20.0, step: float = 0.2, sag: float = 0.0) -> StepResponse:
    """A mass on a spring and a damper that follows a step there and back, `sag` rad below the goal."""
    _, times = step_motion(0.0, step, 4.0, 400.0)
    time = PERIOD * np.arange(round((times[-1] + 0.5) / PERIOD))
    goal = np.interp(
        time, [0.1, 0.1 + PERIOD, *(0.1 + times[1] + np.array([0.0, PERIOD]))], [0, step, step, 0]
    )
    place, speed = 0.0, 0.0
    seen = []
    for wanted in goal:
        seen.append(place - sag)
        speed += PERIOD * (frequency**2 * (wanted - place) - 2.0 * damping * frequency * speed)
        place += PERIOD * speed
    return measure_steps(time, goal, np.array(seen))


@given(st.floats(0.3, 0.8), st.sampled_from([-1.0, 1.0]))
def test_the_overshoot_of_an_oscillator_is_that_of_its_damping(damping: float, way: float) -> None:
    found = oscillator(damping, step=0.2 * way)
    assert found.overshoot == pytest.approx(np.exp(-np.pi * damping / np.sqrt(1.0 - damping**2)), abs=0.02)
    assert found.step == pytest.approx(0.2)


def test_less_damping_rings_and_settles_later() -> None:
    calm, lively = oscillator(0.8), oscillator(0.1)
    assert not calm.rings and lively.rings
    assert lively.settling > 2.0 * calm.settling
    assert lively.iae > calm.iae


def test_what_swings_on_never_settles() -> None:
    found = oscillator(0.001)
    assert found.rings and np.isinf(found.settling)


def test_a_load_shows_as_remaining_error_and_not_as_overshoot() -> None:
    found = oscillator(0.7, sag=0.02)
    assert found.steady_error == pytest.approx(0.02, abs=1e-3)
    assert found.overshoot == pytest.approx(oscillator(0.7).overshoot, abs=1e-3)


@given(st.floats(-2.0, 2.0), st.floats(0.03, 0.5), st.floats(0.5, 6.0), st.floats(2.0, 40.0))
def test_a_step_stays_within_the_limits(
    start: float, way: float, velocity: float, acceleration: float
) -> None:
    positions, times = step_motion(start, start + way, velocity, acceleration)
    duration = float(times[0])
    assert 1.5 * way / duration <= SHARE * velocity + 1e-9
    assert 6.0 * way / duration**2 <= SHARE * acceleration + 1e-9
    assert times[1] - times[0] == pytest.approx(WATCH)
    assert positions[1] == start + way and positions[-1] == start


def test_a_recording_without_both_steps_has_no_figures() -> None:
    time = 0.01 * np.arange(300)
    still: Floats = np.zeros(300)
    once = np.where(time > 1.0, 0.1, 0.0)
    cut = np.where((time > 0.1) & (time < 2.8), 0.1, 0.0)
    for goal in (still, once, cut, np.full(300, np.nan)):
        with pytest.raises(InvalidInput):
            measure_steps(time, goal, goal)
