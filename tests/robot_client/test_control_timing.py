"""The timer of a control loop: no deadline is caught up, and a state has just come at each of them."""

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from twind.robot_client.control_timing import MARGIN, RateTimer, in_step
from twind.robot_client.state_message import StateMessage

EMPTY = np.zeros(0)
STATE = StateMessage(0.0, 0.0, 0, EMPTY, EMPTY, EMPTY, EMPTY, None)


@given(st.lists(st.floats(0.0, 0.09), min_size=1, max_size=50))
def test_deadlines_are_whole_periods_and_never_past(took: list[float]) -> None:
    beat = RateTimer(5.0, 0.02)
    now = 5.0
    for each in took:
        now = max(now, beat.deadline) + each
        beat.advance(now)
        assert -1e-9 < beat.deadline - now <= 0.02 + 1e-9
        assert abs((beat.deadline - 5.0) / 0.02 - round((beat.deadline - 5.0) / 0.02)) < 1e-6


def test_missed_deadlines_are_counted() -> None:
    beat = RateTimer(0.0, 0.02)
    assert [beat.advance(0.005), beat.advance(0.065), beat.advance(0.081)] == [0, 2, 0]
    assert beat.missed == 2 and np.isclose(beat.deadline, 0.1)


def test_the_beat_is_just_after_states_come() -> None:
    rng = np.random.default_rng(0)
    ticks = 3.0 + 0.01 * np.arange(20)
    states = [replace(STATE, time=t, arrived=t + 0.004 + 0.0002 * rng.random()) for t in ticks]
    beat = in_step(states, now=3.1959, period=0.02, loop=0.01)
    phase = (beat.deadline - 3.0) % 0.01
    assert 0.0040 + MARGIN <= phase <= 0.0042 + MARGIN
    assert 0.0 < beat.deadline - 3.1959 <= 0.01


def test_states_that_come_very_late_do_not_push_the_beat_into_the_next_tick() -> None:
    states = [replace(STATE, time=t, arrived=t + 0.03) for t in 0.01 * np.arange(20)]
    assert np.isclose((in_step(states, 0.19, 0.02, 0.01).deadline) % 0.01, 0.009)
