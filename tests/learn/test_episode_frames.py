"""Readings on a fixed grid: lines between two measurements, the last goal held, nothing beyond either end."""

from dataclasses import replace
from math import nan

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.robot_recordings import recording
from twind.learn.dataset.episode_frames import (
    ACTION,
    EFFORT,
    IMU,
    STATE,
    VELOCITY,
    between,
    frames,
    rate,
    too_fast,
)
from twind.learn.dataset.episode_spans import EpisodeSpan, ReadingRun
from twind.observe.recording import RobotRecording
from twind.observe.recording.recording_columns import ImuColumns

GAP = 0.1
PART = EpisodeSpan("pick", 0.0, 10.0, True)


def moving(time: list[float]) -> RobotRecording:
    """A robot whose hip is at 10 t, whose knee at -t; goals are the number of their reading."""
    times = np.array(time)
    still = recording(len(time))
    numbers = np.arange(len(time), dtype=np.float64)
    measured = np.stack([10.0 * times, -times], axis=1)
    goal = np.stack([numbers, -numbers], axis=1)
    return replace(still, time=times, measured=measured, velocity=measured / 2.0, goal=goal)


def test_at_the_rate_of_the_readings_frames_are_the_readings() -> None:
    of = moving([1.0, 1.25, 1.5, 1.75])
    made = frames(of, PART, ReadingRun(0, 3), 4, GAP)
    assert made.count == 4 and made.time == 1.0 and (made.task, made.success) == ("pick", True)
    for name, column in (
        (STATE, of.measured),
        (VELOCITY, of.velocity),
        (EFFORT, of.effort),
        (ACTION, of.goal),
    ):
        assert made.columns[name].dtype == np.float32
        np.testing.assert_array_equal(made.columns[name], column.astype(np.float32))


def test_between_two_readings_a_joint_is_on_the_line_and_its_goal_is_the_one_before() -> None:
    made = frames(moving([0.0, 0.3, 0.6, 0.9, 1.2]), PART, ReadingRun(0, 4), 2, GAP)
    np.testing.assert_allclose(made.columns[STATE], [[0.0, 0.0], [5.0, -0.5], [10.0, -1.0]], rtol=1e-6)
    np.testing.assert_array_equal(made.columns[ACTION], [[0.0, 0.0], [1.0, -1.0], [3.0, -3.0]])


def test_a_stretch_within_a_recording_begins_at_its_own_first_reading() -> None:
    made = frames(moving([0.0, 0.5, 1.0, 1.5, 2.0]), PART, ReadingRun(1, 3), 2, GAP)
    assert made.time == 0.5 and made.columns[ACTION][:, 0].tolist() == [1.0, 2.0, 3.0]


def test_rows_without_a_measurement_are_passed_over_and_their_goal_too() -> None:
    of = moving([0.0, 0.25, 0.5, 0.75, 1.0])
    for table in (of.measured, of.velocity):
        table[1::2] = nan
    made = frames(of, PART, ReadingRun(0, 4), 4, GAP)
    np.testing.assert_allclose(made.columns[STATE][:, 0], [0.0, 2.5, 5.0, 7.5, 10.0])
    assert made.columns[ACTION][:, 0].tolist() == [0.0, 0.0, 2.0, 2.0, 4.0]


def test_a_frame_has_the_last_imu_reading_unless_it_is_too_old() -> None:
    """It tells less often than the joints are read, and then not at all."""
    of = moving([0.0, 0.5, 1.0, 1.5, 2.0])
    numbers = np.arange(50, dtype=np.float64).reshape(5, 10)
    numbers[[0, 2, 3, 4]] = nan
    imu = ImuColumns(numbers[:, :3], numbers[:, 3:6], numbers[:, 6:])
    made = frames(replace(of, imu=imu), PART, ReadingRun(0, 4), 2, 0.6).columns[IMU]
    assert np.isnan(made).all(axis=1).tolist() == [True, False, False, True, True]
    assert made[1].tolist() == made[2].tolist() == list(range(10, 20))
    assert np.isnan(frames(of, PART, ReadingRun(0, 4), 2, 0.6).columns[IMU]).all()


def test_an_unknown_value_stays_unknown_in_its_frame() -> None:
    of = moving([0.0, 0.5, 1.0])
    of.effort[1, 0] = nan
    made = frames(of, PART, ReadingRun(0, 2), 2, GAP)
    assert np.isnan(made.columns[EFFORT]).tolist() == [[False, False], [True, False], [False, False]]


@given(
    st.lists(st.floats(0.001, 0.1), min_size=1, max_size=50),
    st.integers(1, 500),
    st.floats(0.0, 1e5),
)
def test_no_frame_is_before_the_first_reading_nor_after_the_last(
    steps: list[float], fps: int, begin: float
) -> None:
    of = moving(list(begin + np.cumsum([0.0, *steps])))
    made = frames(of, PART, ReadingRun(0, len(steps)), fps, GAP)
    length = of.time[-1] - of.time[0]
    assert (made.count - 1) / fps <= length + 1e-6 and made.count / fps > length - 1e-6
    assert (made.columns[STATE][:, 0] >= np.float32(of.measured[0, 0])).all()
    assert (made.columns[STATE][:, 0] <= np.float32(of.measured[-1, 0])).all()
    grid = begin + np.arange(made.count) / fps
    goals = made.columns[ACTION][:, 0].astype(int)
    assert (of.time[goals] <= grid + 1e-6).all()  # never one that was sent later


def test_a_row_is_given_back_bit_for_bit_even_beside_what_is_unknown() -> None:
    time = np.array([0.0, 1.0, 2.0])
    column = np.array([[0.1], [0.7], [nan]])
    assert between(time, column, np.array([0.0, 1.0])).tolist() == [[0.1], [0.7]]
    assert np.isnan(between(time, column, np.array([1.5, 2.0]))).all()


@pytest.mark.parametrize(
    ("fps", "refused"), [(50, False), (100, False), (104, False), (106, True), (500, True)]
)
def test_frames_faster_than_the_readings_are_refused(fps: int, refused: bool) -> None:
    assert too_fast(recording(), ReadingRun(0, 299), fps) is refused
    assert rate(recording(), ReadingRun(0, 299)) == pytest.approx(100.0)
