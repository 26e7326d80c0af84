"""Content of a flight recorder, as entries and as records of bytes; the same in the ring and in the file."""

import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from enum import IntEnum
from typing import NamedTuple

from twind.exceptions import InvalidInput

LAST = 6_000_000_000  # s: no clock of a recording is later (the year 2160)
NO_BUS = 255  # `FlightEntry.bus` of an entry without a bus
RECORD = struct.Struct("<IBBxxd")  # bytes of data, kind, bus, time; the data follow
HEAD = RECORD.size
# flags of a kind: more pieces follow; a piece that continues the one before
MORE = 0x80
ON = 0x40


class EntryKind(IntEnum):
    """Kind of an entry's data."""

    OUT = 1  # bytes written to a bus
    IN = 2  # bytes read from it
    NEWS = 3  # a datagram loop -> front, as `link.encode` made it
    COMMAND = 4  # a datagram front -> loop
    ARRAYS = 5  # the bytes of the memfd beside the COMMAND before it
    PORT = 6  # OPENED, LOST or REFUSED, a space, and text for people


# The first word of a PORT entry: part of the format of flight files.
OPENED = b"opened"  # then the path
LOST = b"lost"
REFUSED = b"refused"  # then how many bytes


class FlightEntry(NamedTuple):
    """One recorded event."""

    time: float  # s, monotonic
    kind: EntryKind
    bus: int  # place in the robot's order; NO_BUS: none
    data: bytes


def unusable(path: str, what: str, remedy: str) -> InvalidInput:
    """Build the InvalidInput for a file that is no flight recorder."""
    return InvalidInput(f"{what}; {remedy}", where=path)


def broken(path: str, what: str) -> InvalidInput:
    """Build the InvalidInput for a recorder that was complete once and is damaged now."""
    return unusable(path, what, "copy it from the robot again, or use another one")


@dataclass(frozen=True)
class FlightContents:
    """Content of a recorder."""

    kept: dict[int, tuple[FlightEntry, ...]] = field(
        default_factory=dict
    )  # bus -> its last whole identification
    entries: tuple[FlightEntry, ...] = ()  # in the order they were appended, whole ones only

    def pack(self) -> "PackedFlight":
        """Return the same content as bytes."""
        return PackedFlight({bus: pack(entries) for bus, entries in self.kept.items()}, pack(self.entries))


@dataclass(frozen=True)
class PackedFlight:
    """Content of a recorder as bytes: cheap to copy and to save, parsed only when needed."""

    kept: dict[int, bytes]
    entries: bytes

    def parse(self, path: str = "flight recorder") -> FlightContents:
        """Return the content as entries. Raises InvalidInput."""
        kept = {bus: tuple(_parse(path, data)) for bus, data in self.kept.items()}
        return FlightContents(kept, tuple(_parse(path, self.entries)))


def pack(entries: Iterable[FlightEntry]) -> bytes:
    """Return entries as records, one after the other."""
    return b"".join(RECORD.pack(len(data), kind, bus, time) + data for time, kind, bus, data in entries)


def _parse(path: str, data: bytes) -> Iterator[FlightEntry]:
    """Yield whole records; pieces are joined, and incomplete ones are left out."""
    at = 0
    parts: list[bytes] = []
    while at < len(data):
        try:
            size, mark, bus, time = RECORD.unpack_from(data, at)
            kind = EntryKind(mark & ~(MORE | ON))
        except (struct.error, ValueError):
            raise broken(path, f"byte {at} of its records makes no sense") from None
        if not 0.0 <= time <= LAST:
            raise broken(path, f"byte {at} of its records has the time {time:g} s")
        at += HEAD + size
        if at > len(data):
            raise broken(path, f"its last record lacks {at - len(data)} bytes")
        if not mark & ON:
            parts = []
        elif not parts:
            continue  # its beginning was overwritten
        parts.append(data[at - size : at])
        if not mark & MORE:
            yield FlightEntry(time, kind, bus, b"".join(parts))
            parts = []
