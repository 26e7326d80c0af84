"""The flight recorder: the last half minute of bytes in a shared ring, and the file written after a fault.

The loop appends (`FlightRing`); the front copies (`copy`) and writes (`save`); other programs read (`load`).
It handles bytes and times alone; `twind.link` and the drivers interpret them.
"""

from twind.flight.flight_file import LoadedFlight, about, draft, load, save, settle
from twind.flight.flight_records import (
    LOST,
    NO_BUS,
    OPENED,
    REFUSED,
    EntryKind,
    FlightContents,
    FlightEntry,
    PackedFlight,
    pack,
)
from twind.flight.recorder_ring import FlightRing, copy, held_span, read, signature

__all__ = [
    "LOST",
    "NO_BUS",
    "OPENED",
    "REFUSED",
    "EntryKind",
    "FlightContents",
    "FlightEntry",
    "FlightRing",
    "LoadedFlight",
    "PackedFlight",
    "about",
    "copy",
    "draft",
    "held_span",
    "load",
    "pack",
    "read",
    "save",
    "settle",
    "signature",
]
