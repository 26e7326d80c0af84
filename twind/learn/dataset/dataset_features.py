"""Columns of a data set: their description in `meta/info.json`, and their types as LeRobot requires them."""

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


def features(of: DatasetContents) -> dict[str, dict[str, Any]]:
    """Describe each column by its name: dtype, shape, names of its numbers."""
    joints = {name: _feature("float32", of.names(name)) for name in of.features}
    ends = (DONE, SUCCESS) if of.has_success_marks else (DONE,)
    return (
        joints
        | {name: _feature("bool") for name in ends}
        | {"timestamp": _feature("float32")}
        | {name: _feature("int64") for name in COUNTED}
    )


def schema(described: Mapping[str, Mapping[str, Any]]) -> pa.Schema:
    """Return the Arrow schema of the described columns; vectors are lists of fixed size."""
    return pa.schema([(name, _type(each)) for name, each in described.items()])


def columns(
    of: DatasetContents, episode: EpisodeFrames, described: Mapping[str, Any], number: int, first: int
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


def _feature(dtype: str, names: tuple[str, ...] | None = None) -> dict[str, Any]:
    shape = [1 if names is None else len(names)]
    return {"dtype": dtype, "shape": shape, "names": None if names is None else list(names)}


def _type(feature: Mapping[str, Any]) -> pa.DataType:
    kind = _TYPES[feature["dtype"]]
    # a vector of one is a plain number, for a robot of one joint too
    return kind if feature["shape"] == [1] else pa.list_(kind, feature["shape"][0])
