"""Read of one block of several devices: one group read, then a chain of single reads. Pure."""

from collections.abc import Callable, Sequence

from twind_drivers.half_duplex.checksum_packet import read
from twind_drivers.half_duplex.checksum_reply import ChecksumReply
from twind_drivers.half_duplex.half_duplex_transactor import SerialTransaction

ADAPTER = 0.001  # s that a USB adapter adds to each single read of a chain


def chained_read(
    ids: Sequence[int],
    address: int,
    size: int,
    grouped: Callable[[int], bool],
    group_read: Callable[[Sequence[int], int, int], bytes],
    *,
    refusals: bool = False,
) -> SerialTransaction:
    """Return the read: by `group_read(ids, address, size)` of those that are `grouped`, then one by one.

    `refusals`: see `ChecksumReply`.
    """
    together = [id for id in ids if grouped(id)]
    alone = [id for id in ids if not grouped(id)]
    if len(together) == 1:
        together = []
        alone = list(ids)
    singles = [read(id, address, size) for id in alone]
    first = group_read(together, address, size) if together else singles.pop(0)
    asked = [tuple(together), *((id,) for id in alone)] if together else [(id,) for id in alone]
    then = tuple(
        (tuple(ids.index(id) for id in before), request)
        for before, request in zip(asked[:-1], singles, strict=True)
    )
    requests = () if together and not singles else (first, *singles)
    reply = ChecksumReply(ids, size, requests, refusals=refusals)
    return SerialTransaction(first, reply, len(ids), extra=ADAPTER * len(then), then=then)
