"""Attachment of `rmw_zenoh_cpp` to each message and request: number, time, sender. Pure.

Its form is that of rmw_zenoh 0.2.4 (Jazzy), 0.1.2 (Humble) and later, of spring 2025 and since. (Read:
attachment_helpers.cpp and changelogs.)
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from twind.exceptions import InvalidInput

_FORM = struct.Struct("<qqB16s")
_WIDTH = 16  # bytes of a gid


@dataclass(frozen=True, slots=True)
class ZenohAttachment:
    """Attachment: `number` counts a sender's messages, `time_ns` is since 1970, `gid` has 16 bytes."""

    number: int
    time_ns: int
    gid: bytes

    def pack(self) -> bytes:
        """Return its bytes, 33."""
        return _FORM.pack(self.number, self.time_ns, _WIDTH, self.gid)


def attachment(data: bytes) -> ZenohAttachment:
    """Decode an attachment. Raises InvalidInput."""
    if len(data) == _FORM.size:
        number, time_ns, width, gid = _FORM.unpack(data)
        if width == _WIDTH:
            return ZenohAttachment(number, time_ns, gid)
    raise InvalidInput(f"{len(data)} bytes are no attachment: {_FORM.size} with a gid of {_WIDTH}")
