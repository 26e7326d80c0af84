"""Wait for several buses at once: which readers may have a complete reply."""

from collections.abc import Collection, Sequence
from math import inf

from twind_drivers.bus import BusReader
from twind_drivers.clock import Clock

TOGETHER = 0.00015  # s: replies of two buses that end so close together are read after one wait


def ripe(readers: Sequence[BusReader], clock: Clock) -> Collection[int]:
    """Wait until a reader may have its complete reply, or its deadline passes.

    Return the places of such readers.

    The wait ends no earlier than a reply can be complete: on a CAN bus each frame would otherwise wake this
    process, two dozen times a reading. Replies that end close together are read together.
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
