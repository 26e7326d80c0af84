"""Episodes gathered from recordings: what a recording says, value by value, and what is left out of it."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.dataset_recordings import EPISODES, record, record_episodes, stretch
from tests.support.sample_recordings import JOINTS, SteppedWriter, mark, status
from twind.command_line.verb import Rejected
from twind.learn.dataset.episode_collection import DatasetContents, DatasetRequest, gather, line
from twind.learn.dataset.episode_frames import ACTION, EFFORT, IMU, STATE, VELOCITY
from twind.observe.recording import open_recording

CAPTURES = Path(__file__).parents[1] / "data" / "captures"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record_episodes(tmp_path_factory.mktemp("recorded"))


def omissions(contents: DatasetContents) -> str:
    return "\n".join(map(line, contents.left))


def test_every_value_of_every_frame_is_that_of_the_recording(recorded: Path) -> None:
    contents = gather([recorded], DatasetRequest(50))
    of = open_recording(recorded)
    columns = {STATE: of.measured, VELOCITY: of.velocity, EFFORT: of.effort, ACTION: of.goal}
    assert set(contents.features) == set(columns) and contents.robot_type == "two"
    assert contents.joints == JOINTS and contents.tasks == ("pick", "put") and contents.frames == 400
    assert [(each.task, each.success) for each in contents.episodes] == list(EPISODES)
    for number, episode in enumerate(contents.episodes):
        reading = [round(300 * number + 2 * k) for k in range(100)]  # 50 of 100 a second
        assert episode.time == pytest.approx(3.0 * number)
        np.testing.assert_allclose(of.time[reading], 3 * number + np.arange(100) / 50, atol=1e-9)
        for name, column in columns.items():
            np.testing.assert_array_equal(episode.columns[name], column[reading].astype(np.float32))


def test_success_is_known_only_if_every_episode_has_it(recorded: Path) -> None:
    some = gather([recorded], DatasetRequest(50))
    assert not some.has_success_marks and any("next.success (some" in each for each in some.absent)
    marked = gather([recorded], DatasetRequest(50, only_success=True))
    assert marked.has_success_marks and len(marked.episodes) == 2
    assert [each.why for each in marked.left] == ["not marked as a success"] * 2


def test_a_marked_episode_with_a_hole_is_left_out_and_a_recording_without_marks_is_parted(
    tmp_path: Path,
) -> None:
    holed = [*stretch(100.0, 102.0), *stretch(102.5, 104.0)]
    marked = record(tmp_path / "a", status(100.0), mark(100.0, "begin"), *holed, mark(104.0, "end"))
    why = "'pick' at 1.99 s: left out, it has 1 holes; of the first: nothing was read for 0.51 s"
    with pytest.raises(Rejected, match=why):
        gather([marked], DatasetRequest(50))
    bare = record(tmp_path / "b", status(100.0), *holed)
    parted = gather([bare], DatasetRequest(50, "wave"))
    assert [each.count for each in parted.episodes] == [100, 75]
    assert "'wave' at 1.99 s: a hole of 0.51 s: nothing was read for 0.51 s" in omissions(parted)


def test_a_marked_episode_may_be_short_and_an_unmarked_short_one_is_left_out(tmp_path: Path) -> None:
    some = stretch(100.0, 100.5)
    marked = record(tmp_path / "a", status(100.0), mark(100.0, "begin"), *some, mark(100.5, "end"))
    assert gather([marked], DatasetRequest(50)).frames == 25
    with pytest.raises(Rejected, match=r"at 0.00 s: a stretch of 0.49 s, shorter than 1 s"):
        gather([record(tmp_path / "b", status(100.0), *some)], DatasetRequest(50, "wave"))


def test_spans_without_goals_around_an_episode_are_cut_and_reported(tmp_path: Path) -> None:
    idle = [*stretch(100.0, 102.0, goal=None), *stretch(102.0, 104.0), *stretch(104.0, 106.0, goal=None)]
    path = record(tmp_path / "a", status(100.0), mark(100.0, "begin"), *idle, mark(106.0, "end"))
    contents = gather([path], DatasetRequest(50))
    assert [(each.count, each.time) for each in contents.episodes] == [(100, 2.0)]
    left = omissions(contents)
    assert "its first 2.0 s are not in it: there are no goals: the robot was not armed" in left
    assert "at 4.00 s: its last 2.0 s: there are no goals" in left


def test_a_column_unknown_for_some_joint_is_left_out_and_reported(tmp_path: Path) -> None:
    path = record(tmp_path / "a", status(100.0), *stretch(100.0, 102.0, effort=None))
    contents = gather([path], DatasetRequest(50, "wave"))
    assert EFFORT not in contents.features
    assert "observation.effort (not known of every joint in every frame)" in contents.absent


def test_imu_columns_are_present_only_with_continuous_readings(tmp_path: Path) -> None:
    def with_imu(each: dict[str, Any]) -> dict[str, Any]:
        numbers = [each["time"] - 100.0 + place for place in range(10)]
        rows = {"gyro": numbers[:3], "acceleration": numbers[3:6], "quaternion": numbers[6:]}
        return each | {"imu": rows | {"age_ms": 1.0}}

    rows_of = [with_imu(each) for each in stretch(100.0, 102.0)]
    contents = gather([record(tmp_path / "a", status(100.0), *rows_of)], DatasetRequest(50, "lean"))
    assert contents.names(IMU)[::3] == ("gyro_x", "acceleration_x", "quaternion_w", "quaternion_z")
    (episode,) = contents.episodes
    times = np.array([round(k / 50, 2) for k in range(100)])
    np.testing.assert_allclose(episode.columns[IMU], times[:, None] + np.arange(10), atol=1e-5)
    silent = rows_of[:50] + stretch(100.5, 102.0)
    less = gather([record(tmp_path / "b", status(100.0), *silent)], DatasetRequest(50, "lean"))
    assert IMU not in less.features
    assert "observation.imu (none, or not read all the time)" in less.absent


def test_joints_in_another_order_are_put_into_that_of_the_first(recorded: Path, tmp_path: Path) -> None:
    second = tmp_path / "b.mcap"
    turned = [each | {"joints": each["joints"][::-1]} for each in stretch(200.0, 202.0)]
    rig = SteppedWriter(second)
    rig.encoder = type(rig.encoder)(JOINTS[::-1], rig.encoder.clocks)
    rig.take(status(200.0), *turned)
    rig.writer.close()
    assert open_recording(second).joints == ("knee", "hip")
    contents = gather([recorded, second], DatasetRequest(50, "wave"))
    assert contents.joints == ("hip", "knee")
    np.testing.assert_array_equal(
        contents.episodes[-1].columns[STATE],
        np.float32([[math.sin(200 + k / 50), math.sin(201 + k / 50)] for k in range(100)]),
    )


@pytest.mark.parametrize(
    ("asked", "why"),
    [
        (DatasetRequest(500), "500 frames a second of 100 readings a second: --fps at most 100"),
        (DatasetRequest(50, gap=0.001), "holes; of the first: nothing was read for 0.01 s"),
    ],
)
def test_a_request_that_needs_invented_data_is_refused(
    recorded: Path, asked: DatasetRequest, why: str
) -> None:
    with pytest.raises(Rejected, match=why):
        gather([recorded], asked)


def test_an_episode_without_a_task_is_refused_with_the_remedy(tmp_path: Path) -> None:
    path = record(tmp_path / "a", status(100.0), *stretch(100.0, 102.0))
    with pytest.raises(Rejected, match="name it with --task"):
        gather([path], DatasetRequest(50))


def test_recordings_of_two_robots_are_refused(recorded: Path) -> None:
    golden = CAPTURES / "noise.flight"
    with pytest.raises(
        Rejected, match=r"its joints are not those of the recordings before: .*hip.* is not in both"
    ):
        gather([recorded, golden], DatasetRequest(10, "wave", gap=0.15))


def test_a_recording_that_is_named_twice_is_refused(recorded: Path, tmp_path: Path) -> None:
    """Globs overlap, and links have other names: who trains on it must not see an episode twice as often."""
    link = tmp_path / "link.mcap"
    link.symlink_to(recorded)
    for again in (recorded, link):
        with pytest.raises(Rejected, match="once more: name each once"):
            gather([recorded, again], DatasetRequest(50))


def test_a_golden_capture_of_a_fault_gives_the_stretches_in_which_all_was_known() -> None:
    """Recorded over a bus; ten states a second of it are kept."""
    path = CAPTURES / "noise.flight"
    of = open_recording(path)
    contents = gather([path], DatasetRequest(10, "wave", gap=0.15))
    (episode,) = contents.episodes
    assert contents.robot_type == "h24" and len(contents.joints) == 24
    grid = episode.time + np.arange(episode.count) / 10
    for name, column in ((STATE, of.measured), (VELOCITY, of.velocity)):
        lines = np.stack([np.interp(grid, of.time, column[:, j]) for j in range(24)], axis=1)
        np.testing.assert_allclose(episode.columns[name], lines, rtol=1e-6, atol=1e-7)
    held = [np.flatnonzero(of.time <= time + 1e-9)[-1] for time in grid]
    np.testing.assert_array_equal(episode.columns[ACTION], of.goal[held].astype(np.float32))
