"""`twindctl dataset`: what a recording says, value by value, as a reader of its own kind finds it again."""

import json
import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import duckdb
import numpy as np
import pytest

from tests.support.sample_recordings import JOINTS, SteppedWriter, mark, state, status
from twind.command_line.extras import how_to_add
from twind.command_line.verb import Rejected
from twind.ctl.ctl_main import main
from twind.observe.recording import open_recording

pytest.importorskip("pyarrow", reason="make extras EXTRAS=dataset")

from twind.learn.dataset.dataset_folder import write
from twind.learn.dataset.episode_collection import DatasetRequest, gather

CAPTURES = Path(__file__).parents[1] / "data" / "captures"
EPISODES = (("pick", True), ("put", False), ("pick", None), ("pick", True))  # 2 s each, one every 3 s
QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}


def record(folder: Path, *answers: dict[str, Any]) -> Path:
    folder.mkdir(exist_ok=True)
    rig = SteppedWriter(folder)
    rig.take(*answers)
    rig.writer.close()
    return rig.writer.tally.files[0]


def stretch(begin: float, end: float, **more: Any) -> list[dict[str, Any]]:
    """State at 100 Hz; each goal is of its moment."""
    times = [round(begin + k / 100, 2) for k in range(round((end - begin) * 100))]
    return [state(time, **{"goal": math.cos(time), "effort": math.sin(3 * time)} | more) for time in times]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A robot of two joints that does its four episodes, and stands in between, not armed."""
    answers = [status(100.0)]
    for number, (task, success) in enumerate(EPISODES):
        begin = 100.0 + 3 * number
        answers += [mark(begin, "begin", task), *stretch(begin, begin + 2.0)]
        answers += [mark(begin + 2.0, "end", task, success), *stretch(begin + 2.0, begin + 3.0, goal=None)]
    return record(tmp_path_factory.mktemp("recorded"), *answers)


@pytest.fixture(scope="module")
def made(recorded: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The data set of that recording with the usual settings."""
    out = tmp_path_factory.mktemp("made") / "set"
    assert verb(out, recorded) == 0
    return out


def rows(pattern: Path | str, columns: str = "*") -> dict[str, list[Any]]:
    """Columns of parquet files by DuckDB, which shares no code with who wrote them."""
    with duckdb.connect() as reader:
        found = reader.execute(f"SELECT {columns} FROM read_parquet('{pattern}')")
        names = [each[0] for each in found.description]
        table = found.fetchall()
    return dict(zip(names, map(list, zip(*table, strict=True)), strict=True))


def verb(out: Path, *words: str | Path) -> int:
    return main(["dataset", *map(str, words), "--out", str(out)])


def test_every_value_of_every_frame_is_that_of_the_recording(recorded: Path, made: Path) -> None:
    found = rows(made / "data/*/*.parquet")
    of = open_recording(recorded)
    columns = {"observation.state": of.measured, "observation.velocity": of.velocity}
    columns |= {"observation.effort": of.effort, "action": of.goal}
    episode = np.array(found["episode_index"])
    assert np.bincount(episode).tolist() == [100] * 4 and found["index"] == list(range(400))
    for number in range(4):
        mine = episode == number
        reading = [round(300 * number + 2 * k) for k in range(100)]  # 50 of 100 a second
        np.testing.assert_allclose(of.time[reading], 3 * number + np.arange(100) / 50, atol=1e-9)
        for name, column in columns.items():
            assert len(found[name][0]) == len(JOINTS)
            np.testing.assert_array_equal(
                np.array(found[name], np.float32)[mine], column[reading].astype(np.float32)
            )
        np.testing.assert_array_equal(np.array(found["frame_index"])[mine], np.arange(100))
        frame_time = np.array(found["timestamp"], np.float32)[mine]
        np.testing.assert_array_equal(frame_time, (np.arange(100) / 50).astype(np.float32))
        assert np.flatnonzero(np.array(found["next.done"])[mine]).tolist() == [99]
    assert found["task_index"] == [0] * 100 + [1] * 100 + [0] * 200


def test_the_columns_have_the_types_declared_in_the_info_file(made: Path) -> None:
    """LeRobot casts what it loads to these, and fails where it cannot."""
    info = json.loads((made / "meta/info.json").read_text())
    assert info["codebase_version"] == "v3.0" and info["robot_type"] == "two" and info["fps"] == 50
    assert (info["total_episodes"], info["total_frames"], info["total_tasks"]) == (4, 400, 2)
    assert info["splits"] == {"train": "0:4"} and info["video_path"] is None
    kinds = rows(made / "data/chunk-000/file-000.parquet", "DISTINCT typeof(COLUMNS(*))")
    known = {"float32": "FLOAT", "int64": "BIGINT", "bool": "BOOLEAN"}
    assert list(kinds) == list(info["features"])
    for name, feature in info["features"].items():
        vector = feature["names"] is not None
        assert kinds[name] == [known[feature["dtype"]] + ("[]" if vector else "")]
        assert feature["shape"] == [len(JOINTS) if vector else 1]
        assert feature["names"] == (list(JOINTS) if vector else None)


def test_each_episode_row_gives_its_place_task_and_outcome(made: Path) -> None:
    found = rows(made / "meta/episodes/*/*.parquet")
    assert found["episode_index"] == [0, 1, 2, 3] and found["length"] == [100] * 4
    assert found["tasks"] == [["pick"], ["put"], ["pick"], ["pick"]]
    assert found["success"] == [True, False, None, True] and found["recording_time"] == [0.0, 3.0, 6.0, 9.0]
    assert found["dataset_from_index"] == [0, 100, 200, 300]
    assert found["dataset_to_index"] == [100, 200, 300, 400]
    for name in ("data/chunk", "data/file", "meta/episodes/chunk", "meta/episodes/file"):
        assert found[f"{name}_index"] == [0] * 4
    tasks = rows(made / "meta/tasks.parquet")
    assert tasks == {"task_index": [0, 1], "task": ["pick", "put"]}
    with duckdb.connect() as reader:
        said = reader.execute(f"SELECT value FROM parquet_kv_metadata('{made}/meta/tasks.parquet')")
        heads = [json.loads(bytes(row[0])) for row in said.fetchall() if bytes(row[0]).startswith(b"{")]
    assert heads[0]["index_columns"] == ["task"]  # by which LeRobot finds a task's name


def test_success_is_a_column_only_if_every_episode_has_it(recorded: Path, made: Path, tmp_path: Path) -> None:
    assert "next.success" not in json.loads((made / "meta/info.json").read_text())["features"]
    assert "next.success (some episodes are marked neither" in (made / "README.md").read_text()
    assert verb(tmp_path / "all", recorded, "--only-success") == 0
    found = rows(tmp_path / "all/data/*/*.parquet")
    assert np.flatnonzero(found["next.success"]).tolist() == [99, 199]  # of both, the last frame


def test_statistics_are_those_of_the_frames(made: Path) -> None:
    found = rows(made / "data/*/*.parquet")
    stats = json.loads((made / "meta/stats.json").read_text())
    episodes = rows(made / "meta/episodes/*/*.parquet")
    assert set(stats) == set(found)
    for name, column in found.items():
        whole = np.array(column, np.float64).reshape(400, -1)
        for part, said in (
            (whole, stats[name]),
            (whole[100:200], {key: episodes[f"stats/{name}/{key}"][1] for key in stats[name]}),
        ):
            assert said["count"] == [len(part)]
            np.testing.assert_allclose(said["min"], part.min(axis=0))
            np.testing.assert_allclose(said["max"], part.max(axis=0))
            np.testing.assert_allclose(said["mean"], part.mean(axis=0))
            np.testing.assert_allclose(said["std"], part.std(axis=0), atol=1e-12)
            for key, share in QUANTILES.items():
                np.testing.assert_allclose(said[key], np.quantile(part, share, axis=0))


def test_several_episodes_share_a_file_until_it_is_full(recorded: Path, tmp_path: Path) -> None:
    gathered = gather([recorded], DatasetRequest(50))
    write(gathered, tmp_path / "set", file_mb=0.011, chunk=2)
    names = sorted(str(each.relative_to(tmp_path / "set/data")) for each in tmp_path.glob("set/data/*/*"))
    assert names == ["chunk-000/file-000.parquet", "chunk-000/file-001.parquet"]
    found = rows(tmp_path / "set/meta/episodes/*/*.parquet")
    assert found["data/file_index"] == [0, 0, 1, 1] and found["data/chunk_index"] == [0] * 4
    assert found["meta/episodes/chunk_index"] == [0, 0, 1, 1]  # each a file, two of them a folder
    assert found["meta/episodes/file_index"] == [0, 1, 0, 1]
    for number in range(4):
        path = tmp_path / f"set/data/chunk-000/file-{found['data/file_index'][number]:03d}.parquet"
        inside = rows(path)["index"]
        assert (
            found["dataset_from_index"][number] in inside and found["dataset_to_index"][number] - 1 in inside
        )
    assert rows(tmp_path / "set/data/*/*.parquet")["index"] == list(range(400))


def test_the_same_recordings_give_the_same_bytes(recorded: Path, made: Path, tmp_path: Path) -> None:
    assert verb(tmp_path / "two", recorded) == 0
    files = [each.relative_to(made) for each in sorted(made.rglob("*")) if each.is_file()]
    assert len(files) == 6
    for each in files:
        assert (made / each).read_bytes() == (tmp_path / "two" / each).read_bytes()


def test_a_marked_episode_with_a_hole_is_left_out_and_a_recording_without_marks_is_parted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    holed = [*stretch(100.0, 102.0), *stretch(102.5, 104.0)]
    marked = record(tmp_path / "a", status(100.0), mark(100.0, "begin"), *holed, mark(104.0, "end"))
    assert verb(tmp_path / "set", marked) == 1
    said = "'pick' at 1.99 s: left out, it has 1 holes; of the first: nothing was read for 0.51 s"
    assert said in capsys.readouterr().err
    bare = record(tmp_path / "b", status(100.0), *holed)
    assert verb(tmp_path / "set", bare, "--task", "wave") == 0
    assert rows(tmp_path / "set/meta/episodes/*/*.parquet")["length"] == [100, 75]
    assert "'wave' at 1.99 s: a hole of 0.51 s: nothing was read for 0.51 s" in capsys.readouterr().out


def test_a_marked_episode_may_be_short_and_an_unmarked_short_one_is_left_out(tmp_path: Path) -> None:
    some = stretch(100.0, 100.5)
    marked = record(tmp_path / "a", status(100.0), mark(100.0, "begin"), *some, mark(100.5, "end"))
    assert gather([marked], DatasetRequest(50)).frames == 25
    with pytest.raises(Rejected, match=r"at 0.00 s: a stretch of 0.49 s, shorter than 1 s"):
        gather([record(tmp_path / "b", status(100.0), *some)], DatasetRequest(50, "wave"))


def test_spans_without_goals_around_an_episode_are_cut_and_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    idle = [*stretch(100.0, 102.0, goal=None), *stretch(102.0, 104.0), *stretch(104.0, 106.0, goal=None)]
    path = record(tmp_path / "a", status(100.0), mark(100.0, "begin"), *idle, mark(106.0, "end"))
    assert verb(tmp_path / "set", path) == 0
    found = rows(tmp_path / "set/meta/episodes/*/*.parquet")
    assert found["length"] == [100] and found["recording_time"] == [2.0]
    said = capsys.readouterr().out
    assert "its first 2.0 s are not in it: there are no goals: the robot was not armed" in said
    assert "at 4.00 s: its last 2.0 s: there are no goals" in said


def test_a_column_unknown_for_some_joint_is_left_out_and_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = record(tmp_path / "a", status(100.0), *stretch(100.0, 102.0, effort=None))
    assert verb(tmp_path / "set", path, "--task", "wave") == 0
    assert "observation.effort" not in rows(tmp_path / "set/data/*/*.parquet")
    assert "observation.effort (not known of every joint in every frame)" in capsys.readouterr().out


def test_imu_columns_are_present_only_with_continuous_readings(tmp_path: Path) -> None:
    def with_imu(each: dict[str, Any]) -> dict[str, Any]:
        numbers = [each["time"] - 100.0 + place for place in range(10)]
        rows = {"gyro": numbers[:3], "acceleration": numbers[3:6], "quaternion": numbers[6:]}
        return each | {"imu": rows | {"age_ms": 1.0}}

    rows_of = [with_imu(each) for each in stretch(100.0, 102.0)]
    assert verb(tmp_path / "set", record(tmp_path / "a", status(100.0), *rows_of), "--task", "lean") == 0
    info = json.loads((tmp_path / "set/meta/info.json").read_text())["features"]["observation.imu"]
    assert info["shape"] == [10] and info["names"][::3] == [
        "gyro_x",
        "acceleration_x",
        "quaternion_w",
        "quaternion_z",
    ]
    values = np.array(rows(tmp_path / "set/data/*/*.parquet")["observation.imu"], np.float32)
    times = np.array([round(k / 50, 2) for k in range(100)])
    np.testing.assert_allclose(values, times[:, None] + np.arange(10), atol=1e-5)
    silent = rows_of[:50] + stretch(100.5, 102.0)
    assert verb(tmp_path / "less", record(tmp_path / "b", status(100.0), *silent), "--task", "lean") == 0
    assert "observation.imu (none, or not read all the time)" in (tmp_path / "less/README.md").read_text()


def test_joints_in_another_order_are_put_into_that_of_the_first(recorded: Path, tmp_path: Path) -> None:
    first = open_recording(recorded)
    second = tmp_path / "b.mcap"
    assert first.joints == ("hip", "knee")
    turned = [
        state(each["time"], goal=0.25) | {"joints": each["joints"][::-1]} for each in stretch(200.0, 202.0)
    ]
    rig = SteppedWriter(second)
    rig.encoder = type(rig.encoder)(JOINTS[::-1], rig.encoder.clocks)
    rig.take(status(200.0), *turned)
    rig.writer.close()
    assert open_recording(second).joints == ("knee", "hip")
    assert verb(tmp_path / "set", recorded, second, "--task", "wave") == 0
    last = np.array(rows(tmp_path / "set/data/*/*.parquet")["observation.state"][400:], np.float32)
    np.testing.assert_array_equal(
        last, np.float32([[math.sin(200 + k / 50), math.sin(201 + k / 50)] for k in range(100)])
    )


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["--fps", "500"], "500 frames a second of 100 readings a second: --fps at most 100"),
        (["--gap", "0.001"], "holes; of the first: nothing was read for 0.01 s"),
    ],
)
def test_a_request_that_needs_invented_data_is_refused(
    recorded: Path, tmp_path: Path, words: list[str], why: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert verb(tmp_path / "set", recorded, *words) == 1
    assert why in capsys.readouterr().err and not list(tmp_path.iterdir())


def test_an_episode_without_a_task_is_refused_with_the_remedy(tmp_path: Path) -> None:
    path = record(tmp_path / "a", status(100.0), *stretch(100.0, 102.0))
    with pytest.raises(Rejected, match="name it with --task"):
        gather([path], DatasetRequest(50))


def test_recordings_of_two_robots_are_refused(recorded: Path, tmp_path: Path) -> None:
    golden = CAPTURES / "noise.flight"
    with pytest.raises(
        Rejected, match=r"its joints are not those of the recordings before: .*hip.* is not in both"
    ):
        gather([recorded, golden], DatasetRequest(10, "wave", gap=0.15))


def test_a_recording_that_is_named_twice_is_refused(recorded: Path, tmp_path: Path, capsys: Any) -> None:
    """Globs overlap, and links have other names: who trains on it must not see an episode twice as often."""
    link = tmp_path / "link.mcap"
    link.symlink_to(recorded)
    for again in (recorded, link):
        assert verb(tmp_path / "set", recorded, again) == 1
        assert "once more: name each once" in capsys.readouterr().err
    assert not (tmp_path / "set").exists()


def test_nothing_is_written_over_or_added_to(recorded: Path, tmp_path: Path, capsys: Any) -> None:
    (tmp_path / "set").mkdir()
    assert verb(tmp_path / "set", recorded) == 0  # an empty folder is nothing
    before = {each: each.read_bytes() for each in (tmp_path / "set").rglob("*") if each.is_file()}
    assert verb(tmp_path / "set", recorded, "--fps", "25") == 1
    assert "is there already, and nothing is added to it" in capsys.readouterr().err
    assert before == {each: each.read_bytes() for each in (tmp_path / "set").rglob("*") if each.is_file()}


@pytest.mark.parametrize("error", [KeyboardInterrupt(), OSError(28, "No space left on device")])
def test_an_interrupted_export_leaves_no_file(
    recorded: Path, tmp_path: Path, error: BaseException, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stop(*_: object) -> None:
        assert [each.name for each in tmp_path.iterdir()] == [f".set.{os.getpid()}.half"]
        raise error

    monkeypatch.setattr("twind.learn.dataset.dataset_folder._sync", stop)
    assert verb(tmp_path / "set", recorded) in (1, 130)
    assert not list(tmp_path.iterdir())


def test_a_golden_capture_of_a_fault_gives_the_stretches_in_which_all_was_known(tmp_path: Path) -> None:
    """Recorded over a bus; ten states a second of it are kept."""
    path = CAPTURES / "noise.flight"
    of = open_recording(path)
    gathered = gather([path], DatasetRequest(10, "wave", gap=0.15))
    write(gathered, tmp_path / "set")
    found = rows(tmp_path / "set/data/*/*.parquet")
    (episode,) = gathered.episodes
    assert gathered.robot_type == "h24" and len(gathered.joints) == 24
    grid = episode.time + np.arange(episode.count) / 10
    for name, column in (("observation.state", of.measured), ("observation.velocity", of.velocity)):
        lines = np.stack([np.interp(grid, of.time, column[:, j]) for j in range(24)], axis=1)
        np.testing.assert_allclose(np.array(found[name]), lines, rtol=1e-6, atol=1e-7)
    held = [np.flatnonzero(of.time <= time + 1e-9)[-1] for time in grid]
    np.testing.assert_array_equal(np.array(found["action"], np.float32), of.goal[held].astype(np.float32))


def test_a_missing_pyarrow_is_reported_with_its_install_command(
    recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("twind.learn.dataset.dataset_command.find_spec", lambda name: None)
    assert verb(tmp_path / "set", recorded) == 2
    assert capsys.readouterr().err == f"twindctl: dataset needs pyarrow: {how_to_add('dataset')}\n"


@pytest.mark.parametrize("words", [["--fps", "0"], ["--gap", "0"], ["--gap", "nan"]])
def test_figures_that_mean_nothing_are_a_usage_error(
    recorded: Path, tmp_path: Path, words: Sequence[str]
) -> None:
    assert verb(tmp_path / "set", recorded, *words) == 2


def test_the_dataset_result_is_printed_as_json_on_request(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["--json", "dataset", str(recorded), "--out", str(tmp_path / "set"), "--only-success"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert (said["episodes"], said["frames"], said["tasks"]) == (2, 200, ["pick"])
    assert [each["why"] for each in said["left_out"]] == ["not marked as a success"] * 2
