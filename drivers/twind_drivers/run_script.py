"""Blocking run of a script, for tools that own a port alone."""

from typing import Any, TypeVar

from twind_drivers.bus import BusReader, PingRequest, ReadRequest, Script
from twind_drivers.bus_writer import BusWriter
from twind_drivers.clock import Clock

T = TypeVar("T")


def perform(reader: BusReader, script: Script[T], clock: Clock, writer: BusWriter | None = None) -> T:
    """Run a script to its end, blocking: for tools that own the port alone (scan, failsafe, tests)."""
    try:
        request = next(script)
        while True:
            now = clock.now()
            if isinstance(request, PingRequest | ReadRequest):
                reader.begin(request, now)
            elif writer is not None:
                writer.begin(request, now)
            else:
                raise TypeError(f"{reader.name}: {request} writes, and this bus was opened read-only")
            while not reader.feed(clock.now()) and clock.now() < reader.deadline:
                clock.wait([reader.transport], reader.deadline)
            request = script.send(reader.answer(clock.now()))
    except StopIteration as stop:
        result: Any = stop.value
        return result  # type: ignore[no-any-return]
