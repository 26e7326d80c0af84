"""Columns of a data set: description in `meta/info.json`, types and statistics as LeRobot requires them.

Keys and shapes of the statistics are those of LeRobot's `meta/stats.json`. Quantiles are exact, over all
values. LeRobot estimates its own with a histogram, and those of a data set from those of its episodes.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from twind.learn.dataset.episode_collection import DatasetContents
from twind.learn.dataset.episode_frames import EpisodeFrames

DONE = "next.done"
SUCCESS = "next.success"
COUNTED = ("frame_index", "episode_index", "index", "task_index")
_TYPES = {"float32": pa.float32(), "int64": pa.int64(), "bool": pa.bool_()}
Column = NDArray[Any]


def features(of: DatasetContents) -> dict[str, dict[str, object]]:
    """Describe each column by its name: dtype, shape, names of its numbers."""
    joints = {name: _feature("float32", of.names(name)) for name in of.features}
    ends = (DONE, SUCCESS) if of.has_success_marks else (DONE,)
    return (
        joints
        | {name: _feature("bool") for name in ends}
        | {"timestamp": _feature("float32")}
        | {name: _feature("int64") for name in COUNTED}
    )


def schema(described: Mapping[str, Mapping[str, object]]) -> pa.Schema:
    """Return the Arrow schema of the described columns; vectors are lists of fixed size."""
    return pa.schema([(name, _type(each)) for name, each in described.items()])


def columns(
    of: DatasetContents, episode: EpisodeFrames, described: Mapping[str, object], number: int, first: int
) -> dict[str, Column]:
    """Return the columns of one episode, in the order of `described`.

    `number` is the index of the episode, `first` the index of its first frame.
    """
    count = np.arange(episode.count)
    last = count == episode.count - 1
    made: dict[str, Column] = {
        **episode.columns,
        DONE: last,
        SUCCESS: last & bool(episode.success),
        "timestamp": (count / of.fps).astype(np.float32),
        "frame_index": count,
        "episode_index": np.full_like(count, number),
        "index": count + first,
        "task_index": np.full_like(count, of.tasks.index(episode.task)),
    }
    return {name: made[name] for name in described}


def table(made: Mapping[str, Column], of: pa.Schema) -> pa.Table:
    """Return a table of columns of shape (k,) and (k, n)."""
    arrays = []
    for name, column in made.items():
        kind = of.field(name).type
        if pa.types.is_fixed_size_list(kind):
            flat = pa.array(np.ascontiguousarray(column).reshape(-1), kind.value_type)
            arrays.append(pa.FixedSizeListArray.from_arrays(flat, type=kind))
        else:
            arrays.append(pa.array(column.reshape(-1), kind))
    return pa.Table.from_arrays(arrays, schema=of)


def _feature(dtype: str, names: tuple[str, ...] | None = None) -> dict[str, object]:
    shape = [1 if names is None else len(names)]
    return {"dtype": dtype, "shape": shape, "names": None if names is None else list(names)}


def _type(feature: Mapping[str, Any]) -> pa.DataType:
    kind = _TYPES[feature["dtype"]]
    # a vector of one is a plain number, for a robot of one joint too
    return kind if feature["shape"] == [1] else pa.list_(kind, feature["shape"][0])


QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
Stats = dict[str, list[Any]]


def stats(column: NDArray[Any]) -> Stats:
    """Return the statistics of a column (k,) or (k, n), k > 0: lists of n numbers (or of 1).

    `count` is the number of frames.
    """
    rows = column.reshape(len(column), -1)
    wide = rows.astype(np.float64)
    found: Stats = {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()}
    found |= {"mean": wide.mean(axis=0).tolist(), "std": wide.std(axis=0).tolist(), "count": [len(rows)]}
    quantiles = np.quantile(wide, list(QUANTILES.values()), axis=0)
    return found | {name: row.tolist() for name, row in zip(QUANTILES, quantiles, strict=True)}


def flat(of: Mapping[str, Stats]) -> dict[str, list[Any]]:
    """Return the statistics as columns of `meta/episodes`: stats/FEATURE/KEY."""
    return {f"stats/{name}/{key}": value for name, each in of.items() for key, value in each.items()}
