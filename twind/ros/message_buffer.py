"""Messages at the loop's rate: only stamps and numbers change, so the bytes of one message are patched.

Standard library only.
"""

import struct
from collections.abc import Mapping, Sequence

from twind.ros.cdr import CdrReader, encode
from twind.ros.joint_state_message import SECOND
from twind.ros.message_definitions import PRIMITIVES, TEXT, TIME, MessageDefinitions, definitions_of

_STAMP = struct.Struct("<iI")
_WIDTH = 8  # bytes of a number


class MessageBuffer:
    """Bytes of one message, with the same texts and lengths every time. Not for several threads."""

    def __init__(self, kind: str, message: Mapping[str, object]) -> None:
        """Take the texts and lengths of `message`."""
        self._data = bytearray(encode(kind, message))
        self._stamps: list[int] = []  # first byte of each
        self._runs: list[list[int]] = []  # first byte and length of each row of float64 without a gap
        definitions = definitions_of(kind)
        self._find(CdrReader(bytes(self._data)), definitions, definitions.name)
        self._rows = [(first, count, struct.Struct(f"<{count}d")) for first, count in self._runs]
        self.size = sum(count for _, count in self._runs)  # numbers of the message

    def fill(self, time_ns: int, numbers: Sequence[float]) -> bytes:
        """Return the bytes with this time in all stamps, and all numbers in order. Raises struct.error."""
        moment = divmod(time_ns, SECOND)
        for place in self._stamps:
            _STAMP.pack_into(self._data, place, *moment)
        done = 0
        for first, count, row in self._rows:
            row.pack_into(self._data, first, *numbers[done : done + count])
            done += count
        return bytes(self._data)

    def _find(self, source: CdrReader, definitions: MessageDefinitions, name: str) -> None:
        """Note the places of stamps and numbers while reading one type."""
        for field in definitions.fields(name):
            nested = field.kind not in PRIMITIVES and field.kind != TEXT
            if nested or field.kind == "float64":
                count = 1
                if field.many:
                    count = source.numbers("I", 4, 1)[0] if field.count is None else field.count
                for _ in range(count):
                    self._find_one(source, definitions, field.kind)
            else:
                source.field(definitions, field)

    def _find_one(self, source: CdrReader, definitions: MessageDefinitions, kind: str) -> None:
        if kind == TIME:
            source.numbers("I", 4, 2)
            self._stamps.append(source.place - _STAMP.size)
        elif kind != "float64":
            self._find(source, definitions, kind)
        else:
            source.numbers("d", _WIDTH, 1)
            first = source.place - _WIDTH
            if self._runs and first == self._runs[-1][0] + _WIDTH * self._runs[-1][1]:
                self._runs[-1][1] += 1
            else:
                self._runs.append([first, 1])
