"""Messages of JointState as numbers: taken one by one, kept as arrays, so that an hour of them fits."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twind.ros import JointStateLayout

BATCH = 4096  # messages whose bytes are kept before they become numbers

Floats = NDArray[np.float64]
Times = NDArray[np.int64]


class JointStateBlock(NamedTuple):
    """Messages of one layout: times (k,) in ns; position, velocity, effort, each (k, n) or None."""

    names: tuple[str, ...]
    times: Times
    columns: tuple[Floats | None, ...]


class JointRows:
    """The messages of one topic. After `settled`: `names` of all of them, `times` (k,) in ns."""

    def __init__(self) -> None:
        self.names: tuple[str, ...] = ()
        self.times: Times = np.zeros(0, np.int64)
        self._blocks: list[JointStateBlock] = []
        self._layout: JointStateLayout | None = None
        self._times: list[int] = []
        self._data: list[bytes] = []

    def add(self, time_ns: int, data: bytes) -> None:
        """The next message. Raises InvalidInput."""
        if self._layout is None or not self._layout.fits(data):
            self._settle()
            self._layout = JointStateLayout.from_message(data)
        self._times.append(time_ns)
        self._data.append(data)
        if len(self._data) == BATCH:
            self._settle()

    def settled(self) -> "JointRows":
        """Itself, when no more come."""
        self._settle()
        self.names = tuple(dict.fromkeys(name for block in self._blocks for name in block.names))
        self.times = np.concatenate([np.zeros(0, np.int64), *(block.times for block in self._blocks)])
        return self

    def lay(self, table: Floats, times: Times, joints: Sequence[str], place: int) -> None:
        """Write one column of each message (0 position, 1 velocity, 2 effort) into the rows of its time."""
        for block in self._blocks:
            numbers = block.columns[place]
            if numbers is not None:
                at = np.searchsorted(times, block.times)
                table[at[:, None], np.array([joints.index(name) for name in block.names])] = numbers

    def _settle(self) -> None:
        """Convert the messages since the last block into a block."""
        if self._layout is None or not self._data:
            return
        layout = self._layout
        count = len(self._data)
        raw = np.frombuffer(b"".join(self._data), np.uint8).reshape(count, layout.size)
        columns = tuple(_column(raw, first, many, len(layout.names)) for first, many in layout.columns)
        self._blocks.append(JointStateBlock(layout.names, np.array(self._times, np.int64), columns))
        self._times = []
        self._data = []


def _column(raw: NDArray[np.uint8], first: int, many: int, joints: int) -> Floats | None:
    """The float64 from byte `first` of each row on; None where there is not one for each joint."""
    if many != joints or not many:
        return None
    return np.ascontiguousarray(raw[:, first : first + 8 * many]).view("<f8")
