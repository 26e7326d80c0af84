"""Stretches of a recording that can be learnt from, and a reason for all others."""

from dataclasses import replace
from math import nan

import numpy as np
import pytest

from tests.support.robot_recordings import recording
from twind.learn.dataset.episode_spans import EpisodeSpan, OmittedSpan, ReadingCoverage, ReadingRun, parts
from twind.observe.recording.recording_columns import (
    RecordedEpisode,
    RecordedMessage,
    RobotRecording,
    SlowColumns,
)

ALL = EpisodeSpan("pick", 0.0, 10.0, True)


def without(column: str, rows: slice, joint: int | slice = slice(None)) -> RobotRecording:
    """The same with values that are not known."""
    whole = recording()
    table = getattr(whole, column).copy()
    table[rows, joint] = nan
    return replace(whole, **{column: table})


def test_a_recording_of_an_armed_robot_is_one_stretch() -> None:
    assert ReadingCoverage(recording(), 0.1).runs(ALL) == [ReadingRun(0, 299)]
    assert ReadingCoverage(recording(), 0.1).runs(replace(ALL, begin=1.0, end=2.0)) == [ReadingRun(100, 200)]


@pytest.mark.parametrize(
    ("given", "why"),
    [
        (without("measured", slice(100, 110), 1), "knee is unknown"),
        (without("goal", slice(100, 110)), "there are no goals: the robot was not armed"),
        (without("goal", slice(100, 110), 0), "hip had no goal"),
    ],
)
def test_an_unknown_value_ends_a_run_and_another_begins_after_it(given: RobotRecording, why: str) -> None:
    whole = ReadingCoverage(given, 0.2)
    assert whole.runs(ALL) == [ReadingRun(0, 99), ReadingRun(110, 299)]
    assert whole.hole(ALL, 99) == (1.0, why)


@pytest.mark.parametrize(("missing", "joined"), [(8, True), (9, True), (10, False), (50, False)])
def test_a_hole_is_what_is_longer_than_the_bound_and_nothing_is_put_into_it(
    missing: int, joined: bool
) -> None:
    whole = recording()
    keep = np.r_[0:100, 100 + missing : 300]
    rows = {
        name: getattr(whole, name)[keep] for name in ("measured", "velocity", "effort", "goal", "simulated")
    }
    told = ReadingCoverage(replace(whole, time=whole.time[keep], **rows), 0.1001)
    assert (told.runs(ALL) == [ReadingRun(0, 299 - missing)]) is joined
    if not joined:
        assert told.runs(ALL) == [ReadingRun(0, 99), ReadingRun(100, 299 - missing)]
        assert told.hole(ALL, 99) == (0.99, f"nothing was read for {(missing + 1) / 100:.2f} s")


def test_rows_of_another_times_message_are_no_hole_but_a_missing_reading_is() -> None:
    whole = recording()
    other = np.arange(1, 300, 2)  # the goals alone, of every second moment
    rows = {name: getattr(whole, name).copy() for name in ("measured", "velocity", "effort")}
    for table in rows.values():
        table[other] = nan
    assert ReadingCoverage(replace(whole, **rows), 0.1).runs(ALL) == [ReadingRun(0, 298)]


def test_goals_that_went_to_the_simulation_are_no_actions_of_the_robot() -> None:
    modes = (RecordedMessage(0.0, {"mode": "mirror"}), RecordedMessage(1.0, {"mode": "live"}))
    whole = ReadingCoverage(recording(statuses=modes), 0.1)
    assert whole.runs(ALL) == [ReadingRun(100, 299)]
    assert whole.hole(ALL) == (0.0, "commands went to the simulation, not to the robot")


def test_a_joint_that_did_not_answer_is_left_out_from_its_last_answer_to_its_next() -> None:
    """Its position is recorded all the while: the last one that it told."""
    times = np.array([0.0, 0.5, 1.0, 1.5, 2.0])
    ages = np.array(
        [[0.0, 0.0], [0.0, 0.05], [0.0, 0.4], [0.0, 0.01], [0.0, 0.0]]
    )  # knee: heard at 0.6, 1.49
    blank = np.zeros((5, 2))
    whole = ReadingCoverage(recording(slow=SlowColumns(times, blank, blank, blank, ages)), 0.1)
    assert whole.runs(ALL) == [ReadingRun(0, 60), ReadingRun(149, 299)]
    assert whole.hole(ALL, 60) == (0.61, "knee did not answer")


def test_a_joint_that_never_answered_again_is_left_out_to_the_end() -> None:
    blank = np.zeros((2, 2))
    ages = np.array([[0.3, 0.0], [1.3, 0.0]])
    whole = ReadingCoverage(recording(slow=SlowColumns(np.array([1.0, 2.0]), blank, blank, blank, ages)), 0.1)
    assert whole.runs(ALL) == [ReadingRun(0, 70)]


def test_a_part_without_any_reading_has_no_stretch_and_a_reason() -> None:
    whole = ReadingCoverage(recording(), 0.1)
    part = replace(ALL, begin=20.0, end=30.0)
    assert whole.runs(part) == [] and whole.hole(part) == (20.0, "no joint was measured in it")


def test_episodes_are_the_marked_ones_and_one_that_this_file_has_not_whole_is_left_out() -> None:
    marks = (
        RecordedEpisode("", nan, 0.5, True),
        RecordedEpisode("pick", 1.0, 2.0, None),
        RecordedEpisode("put", 2.5, nan, None),
    )
    found, left = parts(recording(episodes=marks), "wave")
    assert found == [EpisodeSpan("pick", 1.0, 2.0, None)]
    assert left == [
        OmittedSpan("a.mcap", "wave", 0.5, "its beginning is not in this file"),
        OmittedSpan("a.mcap", "put", 2.5, "its end is not in this file"),
    ]


def test_without_marks_all_of_a_recording_is_one_part() -> None:
    assert parts(recording(), "wave") == ([EpisodeSpan("wave", 0.0, 2.99, None)], [])
