"""Lookup of the actuator of a frame by table, the same for every family. Pure."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twind_drivers.bus import Floats, Ints
from twind_drivers.can.actuator_family import ActuatorFeedback, FamilyRegister
from twind_drivers.ports.frame import Frames, frames

Table = NDArray[np.int64]
NONE = -1  # no actuator of this bus


def checked_ids(port: str, family: str, ids: Sequence[int], least: int, most: int) -> tuple[int, ...]:
    """Return `ids`. Raises ValueError unless each is within `least..most` and occurs once."""
    for id in ids:
        if not least <= id <= most:
            raise ValueError(f"{port}: {family} id {id} outside {least}..{most}")
        if list(ids).count(id) > 1:
            raise ValueError(f"{port}: {family} id {id} stands there twice")
    return tuple(int(id) for id in ids)


def row_of(table: Table, keys: NDArray[Any]) -> Ints:
    """Return the row by key; keys beyond the table give `NONE`, which must be its last entry."""
    rows: Ints = table.take(keys, mode="clip")
    return rows


def to_one(id: int, data: bytes) -> Frames:
    """One frame with `data`, up to 8 bytes."""
    made = frames([id])
    made["data"][0, : len(data)] = np.frombuffer(data, np.uint8)
    made["size"] = len(data)
    return made


def column(values: Sequence[float]) -> Floats:
    """Return a copy of the values as an array (k,)."""
    return np.array(values, np.float64)


def four(port: str, parameter: FamilyRegister, data: bytes) -> bytes:
    """Return `data` for a writable register. Raises ValueError for another one, or not 4 bytes."""
    if not parameter.writable:
        raise ValueError(f"{port}: {parameter.name} ({parameter.address:#x}) is not written by this driver")
    if len(data) != 4:
        raise ValueError(f"{port}: {parameter.name}: {len(data)} bytes, 4 are needed")
    return data


def untold(rows: Ints) -> ActuatorFeedback:
    """Return feedback of `rows` (j,) with all values unknown."""
    count = len(rows)
    nan = np.full(count, np.nan)
    unsaid = np.full(count, -1, np.int64)
    return ActuatorFeedback(rows, nan, nan.copy(), nan.copy(), unsaid, unsaid.copy(), nan.copy(), nan.copy())


def by_name(*parameters: FamilyRegister) -> Mapping[str, FamilyRegister]:
    """Parameters by their names."""
    return {parameter.name: parameter for parameter in parameters}
