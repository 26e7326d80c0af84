"""The flight recorder: the last half minute of bytes in a shared ring, and the file that a fault leaves.

The loop appends (`Ring`); the front copies (`copy`) and writes (`save`); whoever looks on reads (`load`).
Knows bytes and times alone: what they mean say `twind.link` and the drivers.
"""

from twind.flight.file import Flight, load, save
from twind.flight.records import NO_BUS, Contents, Entry, FlightError, Kind, Packed, pack
from twind.flight.ring import Ring, copy, read

__all__ = [
    "NO_BUS",
    "Contents",
    "Entry",
    "Flight",
    "FlightError",
    "Kind",
    "Packed",
    "Ring",
    "copy",
    "load",
    "pack",
    "read",
    "save",
]
