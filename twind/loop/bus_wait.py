"""Waiting for several buses at once: who is worth a look."""

from collections.abc import Collection, Sequence
from math import inf

from twind_drivers.bus import BusReader
from twind_drivers.clock import Clock

TOGETHER = 0.00015  # s: answers of two buses that end so close are taken in one look


def ripe(readers: Sequence[BusReader], clock: Clock) -> Collection[int]:
    """Until one of them has bytes, or its time is over; places of those that are worth a look.

    Nobody looks before anything can be complete: on a CAN bus each frame would wake us, two dozen times a
    reading. Readings that end close together are taken together.
    """
    now = clock.now()
    earliest = [reader.earliest for reader in readers]
    due = [place for place, at in enumerate(earliest) if at <= now]
    begins = min([at for at in earliest if at > now], default=inf)
    if due and begins - now > TOGETHER:
        until = min(begins, min([readers[place].deadline for place in due]))
        found = clock.wait([readers[place].transport for place in due], until)
        return [due[place] for place in found]
    last = begins if due else begins + TOGETHER
    clock.sleep_until(max([at for at in earliest if at <= last]))
    now = clock.now()
    return [place for place, at in enumerate(earliest) if at <= now]
