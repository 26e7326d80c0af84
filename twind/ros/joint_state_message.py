"""JointState at the loop's rate: of its bytes only the stamp and the numbers change, so they are patched.

Standard library only.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

from twind.exceptions import InvalidInput
from twind.ros.cdr import HEAD, CdrReader, encode
from twind.ros.message_definitions import JOINT_STATE

SECOND = 1_000_000_000  # ns
LAST = (1 << 31) * SECOND - 1  # ns since 1970: a stamp of ROS goes no further, whatever a clock says
Numbers: TypeAlias = Sequence[float] | bytes  # n numbers, or their float64 as they lie in memory
_STAMP = struct.Struct("<iI")
_STILL = len(HEAD) + _STAMP.size  # first byte after the stamp


def stamp(time_ns: int) -> dict[str, int]:
    """builtin_interfaces Time or Duration of `time_ns`; before zero the seconds are negative, as in ROS."""
    return dict(zip(("sec", "nanosec"), divmod(time_ns, SECOND), strict=True))


@dataclass(frozen=True, slots=True)
class JointStateLayout:
    """Places of the numbers in the bytes of a JointState, valid for all messages of the same layout."""

    names: tuple[str, ...]
    columns: tuple[tuple[int, int], ...]  # (first byte, how many) of position, velocity, effort
    size: int  # bytes of the whole
    _fixed: tuple[tuple[int, bytes], ...]  # what stands between stamp and numbers

    @classmethod
    def from_message(cls, data: bytes) -> "JointStateLayout":
        """Read the layout of one JointState message. Raises InvalidInput."""
        source = CdrReader(data)
        fixed = []
        columns = []
        try:
            source.numbers("I", 4, 2)
            source.text()
            names = tuple(source.text() for _ in range(source.numbers("I", 4, 1)[0]))
            after = _STILL
            for _ in range(3):
                (count,) = source.numbers("I", 4, 1)
                end = source.place
                if count:
                    source.numbers("d", 8, count)
                first = source.place - 8 * count
                fixed.append((after, data[after : first if count else end]))
                columns.append((first, count))
                after = source.place
        except (struct.error, UnicodeDecodeError) as error:
            raise InvalidInput(f"{JOINT_STATE}: {error}, at byte {source.place} of {len(data)}") from None
        return cls(names, tuple(columns), len(data), tuple(fixed))

    def fits(self, data: bytes) -> bool:
        """These bytes differ in stamp and numbers alone."""
        return len(data) == self.size and all(data.startswith(part, at) for at, part in self._fixed)


class JointStateBuffer:
    """The bytes of one robot's JointState: same joints and columns every time. Not for several threads."""

    def __init__(self, names: Sequence[str], *, velocity: bool, effort: bool, frame: str = "") -> None:
        """Positions always; velocities and efforts where asked for."""
        zeros = [0.0] * len(names)
        message = {
            "header": {"frame_id": frame},
            "name": list(names),
            "position": zeros,
            "velocity": zeros if velocity else [],
            "effort": zeros if effort else [],
        }
        self._data = bytearray(encode(JOINT_STATE, message))
        asked = (True, velocity, effort)
        columns = zip(JointStateLayout.from_message(bytes(self._data)).columns, asked, strict=True)
        self._places = [first for (first, _), wanted in columns if wanted]
        self._numbers = struct.Struct(f"<{len(names)}d")

    def fill(self, time_ns: int, *columns: Numbers) -> bytes:
        """The bytes with this stamp and these columns: position, then those asked for. Raises ValueError."""
        if len(columns) != len(self._places):
            raise ValueError(f"{len(columns)} columns, must be {len(self._places)}")
        data = self._data
        _STAMP.pack_into(data, len(HEAD), *divmod(time_ns, SECOND))
        for place, column in zip(self._places, columns, strict=True):
            if isinstance(column, bytes):
                if len(column) != self._numbers.size:
                    raise ValueError(f"{len(column)} bytes, must be {self._numbers.size}: float64")
                data[place : place + len(column)] = column
            else:
                try:
                    self._numbers.pack_into(data, place, *column)
                except struct.error as error:
                    raise ValueError(f"a column that does not fit: {error}") from None
        return bytes(data)
