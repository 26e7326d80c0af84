"""Attachment of `rmw_zenoh_cpp` to each message and request: number, time, sender. Pure.

Two forms. Labelled: a name before each value, up to rmw_zenoh 0.2.3 (Jazzy) and 0.1.1 (Humble), of spring
2025. Plain: without them, in every release since. (Read: attachment_helpers.cpp and changelogs.)
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from twind.exceptions import InvalidInput

_PLAIN = struct.Struct("<qqB16s")
_LABELS = ("sequence_number", "source_timestamp", "source_gid")
_NUMBER, _TIME, _GID = (bytes([len(label)]) + label.encode() for label in _LABELS)
_LABELLED = struct.Struct(f"<{len(_NUMBER)}sq{len(_TIME)}sq{len(_GID)}sB16s")
_WIDTH = 16  # bytes of a gid


@dataclass(frozen=True, slots=True)
class ZenohAttachment:
    """Attachment: `number` counts a sender's messages, `time_ns` is since 1970, `gid` has 16 bytes."""

    number: int
    time_ns: int
    gid: bytes
    labelled: bool = False

    def pack(self) -> bytes:
        """Return its bytes, 33, or 78 for the labelled form."""
        if self.labelled:
            return _LABELLED.pack(_NUMBER, self.number, _TIME, self.time_ns, _GID, _WIDTH, self.gid)
        return _PLAIN.pack(self.number, self.time_ns, _WIDTH, self.gid)


def attachment(data: bytes) -> ZenohAttachment:
    """Decode an attachment of either form. Raises InvalidInput."""
    if len(data) == _PLAIN.size and data[_PLAIN.size - _WIDTH - 1] == _WIDTH:
        number, time_ns, _, gid = _PLAIN.unpack(data)
        return ZenohAttachment(number, time_ns, gid)
    if len(data) == _LABELLED.size:
        one, number, two, time_ns, three, width, gid = _LABELLED.unpack(data)
        if (one, two, three, width) == (_NUMBER, _TIME, _GID, _WIDTH):
            return ZenohAttachment(number, time_ns, gid, labelled=True)
    raise InvalidInput(
        f"{len(data)} bytes are no attachment: {_PLAIN.size} or {_LABELLED.size} with a gid of {_WIDTH}"
    )
