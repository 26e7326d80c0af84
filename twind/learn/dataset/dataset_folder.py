"""A LeRobotDataset v3.0 on disk, as LeRobot 0.4 writes and reads it. All of it is there, or nothing.

Read: huggingface/lerobot 0.4.4, datasets/lerobot_dataset.py and datasets/utils.py; the names of files,
columns and keys are theirs.
"""

import contextlib
import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from twind.command_line.verb import Rejected
from twind.learn.dataset.dataset_features import Column, columns, features, flat, schema, stats, table
from twind.learn.dataset.episode_collection import DatasetContents, line
from twind.learn.dataset.episode_frames import ACTION, EFFORT, IMU, STATE, VELOCITY
from twind.learn.dataset.table_shards import NAME, ShardLocation, ShardWriter

VERSION = "v3.0"
CHUNK = 1000  # files of a folder
# of a file, as LeRobot's defaults have it
DATA_MB = 100
VIDEO_MB = 200
_MB = 1 << 20


def spare(out: Path) -> None:
    """Raises Rejected where something is at `out`: nothing is ever written over or into."""
    if out.is_symlink() or (out.exists() and not (out.is_dir() and not any(out.iterdir()))):
        raise Rejected(
            f"{out}: is there already, and nothing is added to it; name all recordings in one call and "
            "another folder, or merge two data sets with LeRobot's own tools"
        )


def write(gathered: DatasetContents, out: Path, *, file_mb: float = DATA_MB, chunk: int = CHUNK) -> None:
    """Make the folder `out`. Raises Rejected where something is there, OSError.

    `file_mb`: the bound of a file; `chunk`: files of a folder.
    """
    spare(out)
    with _half(out) as folder:
        _DatasetWriter(gathered, folder, file_mb, chunk).write()
        _sync(folder)
        try:
            os.rename(folder, out)
        except OSError:
            spare(out)  # another process was first
            raise


class _DatasetWriter:
    """One data set being written."""

    def __init__(self, of: DatasetContents, folder: Path, file_mb: float, chunk: int) -> None:
        self._of = of
        self._folder = folder
        self._file_mb = file_mb
        self._chunk = chunk
        self._features = features(of)
        self._columns: dict[str, list[Column]] = {name: [] for name in self._features}  # of each episode

    def write(self) -> None:
        """Everything."""
        meta = self._folder / "meta"
        meta.mkdir()
        rows = self._data()
        self._episodes(rows)
        _tasks(self._of.tasks, meta / "tasks.parquet")
        whole = {name: stats(np.concatenate(each)) for name, each in self._columns.items()}
        _json(meta / "stats.json", whole)
        _json(meta / "info.json", self._info())
        (self._folder / "README.md").write_text(card(self._of), encoding="utf-8")

    def _shards(self, folder: Path, of: pa.Schema) -> ShardWriter:
        return ShardWriter(folder, of, size=round(self._file_mb * _MB), chunk=self._chunk)

    def _data(self) -> list[dict[str, object]]:
        """Write the frames; return the row of `meta/episodes` of each episode."""
        shape = schema(self._features)
        shards = self._shards(self._folder / "data", shape)
        found = []
        first = 0
        for number, episode in enumerate(self._of.episodes):
            made = columns(self._of, episode, self._features, number, first)
            place = shards.place(episode.count)
            shards.append(table(made, shape))
            row = {"episode_index": number, "tasks": [episode.task], "length": episode.count}
            row |= {"data/chunk_index": place.chunk, "data/file_index": place.file}
            row |= {"dataset_from_index": first, "dataset_to_index": first + episode.count}
            row |= {
                "success": episode.success,
                "recording": episode.recording,
                "recording_time": episode.time,
            }
            found.append(row | flat({name: stats(column) for name, column in made.items()}))
            for name, column in made.items():
                self._columns[name].append(column)
            first += episode.count
        shards.close()
        return found

    def _episodes(self, rows: list[dict[str, object]]) -> None:
        shape = self._episode_schema(rows[0])
        shards = self._shards(self._folder / "meta" / "episodes", shape)
        for row in rows:
            place: ShardLocation = shards.place(1)
            row |= {"meta/episodes/chunk_index": place.chunk, "meta/episodes/file_index": place.file}
            shards.append(pa.Table.from_pylist([row], schema=shape))
        shards.close()

    def _episode_schema(self, row: dict[str, Any]) -> pa.Schema:
        whole = pa.int64()
        text = pa.string()
        kinds = {
            "tasks": pa.list_(text),
            "success": pa.bool_(),
            "recording": text,
            "recording_time": pa.float64(),
        }
        kinds |= {name: _list_of(value[0]) for name, value in row.items() if name.startswith("stats/")}
        places = ("meta/episodes/chunk_index", "meta/episodes/file_index")
        return pa.schema([(name, kinds.get(name, whole)) for name in (*row, *places)])

    def _info(self) -> dict[str, object]:
        of = self._of
        return {
            "codebase_version": VERSION,
            "robot_type": of.robot_type,
            "total_episodes": len(of.episodes),
            "total_frames": of.frames,
            "total_tasks": len(of.tasks),
            "chunks_size": self._chunk,
            "data_files_size_in_mb": self._file_mb,
            "video_files_size_in_mb": VIDEO_MB,
            "fps": of.fps,
            "splits": {"train": f"0:{len(of.episodes)}"},
            "data_path": f"data/{NAME}",
            "video_path": None,
            "features": self._features,
        }


def _list_of(value: bool | int | float) -> pa.DataType:
    kinds = {bool: pa.bool_(), int: pa.int64(), float: pa.float64()}
    return pa.list_(kinds[type(value)])


def _tasks(tasks: tuple[str, ...], path: Path) -> None:
    """LeRobot reads it by pandas and finds tasks by the table's index: so it says which column that is."""
    head = {
        "index_columns": ["task"],
        "column_indexes": [],
        "columns": [_pandas("task_index", "int64", "int64"), _pandas("task", "unicode", "object")],
        "creator": {"library": "twind", "version": "1"},
        "pandas_version": "2.0.0",
    }
    shape = pa.schema([("task_index", pa.int64()), ("task", pa.string())], {"pandas": json.dumps(head)})
    rows = {"task_index": list(range(len(tasks))), "task": list(tasks)}
    pq.write_table(pa.table(rows, schema=shape), path, compression="snappy")


def _pandas(name: str, kind: str, numpy: str) -> dict[str, object]:
    return {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": numpy, "metadata": None}


def _json(path: Path, what: Any) -> None:
    path.write_text(json.dumps(what, indent=4, ensure_ascii=False), encoding="utf-8")


@contextmanager
def _half(out: Path) -> Iterator[Path]:
    """A folder beside `out` that is gone at the end, unless it was renamed."""
    out.parent.mkdir(parents=True, exist_ok=True)
    folder = out.parent / f".{out.name}.{os.getpid()}.half"
    folder.mkdir()
    try:
        yield folder
    finally:
        with contextlib.suppress(FileNotFoundError):
            shutil.rmtree(folder)


def _sync(folder: Path) -> None:
    """Wait until all of it is on the disk, so that a power cut after the rename leaves it whole."""
    for path in (*folder.rglob("*"), folder):
        number = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        try:
            os.fsync(number)
        finally:
            os.close(number)


_MEANINGS = {
    STATE: "measured positions, rad: on the line between the two readings around",
    VELOCITY: "measured velocities, rad/s, likewise",
    EFFORT: "measured torques, N·m, likewise",
    IMU: "of the base, in its own axes: rad/s, m/s², unit quaternion w x y z; as it was last read",
    ACTION: "goals, rad: what passed the gate and was last sent at the frame's time. "
    "What was asked for before the gate is not recorded",
}
_HEAD = """\
---
task_categories:
- robotics
tags:
- LeRobot
configs:
- config_name: default
  data_files: data/*/*.parquet
---
"""


def card(of: DatasetContents) -> str:
    """The text; the same of the same recordings."""
    return _HEAD + "\n".join(_lines(of)) + "\n"


def absent(of: DatasetContents) -> list[str]:
    """Columns that a data set might have and this one has not, with the reason."""
    missing = [name for name in (VELOCITY, EFFORT) if name not in of.features]
    found = [f"{name} (not known of every joint in every frame)" for name in missing]
    found += [] if IMU in of.features else [f"{IMU} (none, or not read all the time)"]
    if not of.has_success_marks:
        found.append("next.success (some episodes are marked neither as success nor as failure)")
    return [*found, "images (recordings have none)"]


def _lines(of: DatasetContents) -> list[str]:
    sources = list(dict.fromkeys(each.recording for each in of.episodes))
    found = ["", f"# {of.robot_type}: {', '.join(of.tasks)}", ""]
    found.append(
        f"LeRobotDataset v3.0 out of recordings of twind: {len(of.episodes)} episodes, {of.frames} frames at "
        f"{of.fps} a second, {len(of.joints)} joints."
    )
    found += ["", "| column | what |", "|---|---|"]
    found += [f"| {name} | {_MEANINGS[name]} |" for name in of.features]
    found.append("| next.done | the last frame of its episode |")
    if of.has_success_marks:
        found.append("| next.success | the last frame of an episode that was marked a success |")
    found += ["| timestamp | s since the episode's first frame |", ""]
    found.append("`meta/episodes` has besides: success (null: not marked), recording, recording_time (s).")
    found += ["", "Not in it:", *(f"- {each}" for each in absent(of))]
    found += [f"- {line(each)}" for each in of.left]
    return [*found, "", "Recordings:", *(f"- {each}" for each in (*sources, *of.damage))]
