"""Indirect addresses: their places in a model's table, and their targets in a new servo. Pure.

The vendor's tables name the first entry and the first of a second row ("Write", "Read"). The X430, X540 and
MX have two rows of 28. The X330 have one row of 28 (20 from firmware 52, where the data lies nearer), the P
series and PRO -R(A) one of 128. Source: e-manual, "Indirect Address, Indirect Data". Own reading of the
vendor's table: the older X330 have as many entries as the room between address and data holds.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

from twind_drivers.dynamixel.control_tables import ControlTable, TableRegister

MOST = 128  # entries in one row


class IndirectRange(NamedTuple):
    """`entries` of them: an address of 2 bytes each from `address` on, a byte of data each from `data` on."""

    address: int
    data: int
    entries: int


def rows(table: ControlTable) -> tuple[IndirectRange, ...]:
    """Return the rows of indirect addresses in one model's table; empty where it has none."""
    keys = ("indirect_address_1", "indirect_data_1", "indirect_address_read", "indirect_data_read")
    if not all(key in table for key in keys):
        return ()
    address, data, more, more_data = (table[key].address for key in keys)
    first = IndirectRange(address, data, min((data - address) // 2, MOST))
    if more - address == 2 * (more_data - data):  # the second row only goes on with the first
        return (first,)
    return (first, IndirectRange(more, more_data, (more_data - more) // 2))


def fields(table: ControlTable) -> Iterator[TableRegister]:
    """Return every indirect register of a model as single registers. When new, entry k points at data k."""
    at, cell = (table.fields.get(key) for key in ("indirect_address_1", "indirect_data_1"))
    if at is None or cell is None:
        return
    found = rows(table)
    most = max(at.bounds[1], *(row.data + row.entries - 1 for row in found)) if found else 0
    number = 0
    for row in found:
        for place in range(row.entries):
            number += 1
            target = row.data + place
            points = replace(at.rule, default=target, upper=most)
            yield replace(
                at,
                name=f"Indirect Address {number}",
                key=f"indirect_address_{number}",
                address=row.address + 2 * place,
                rule=points,
            )
            yield replace(
                cell,
                name=f"Indirect Data {number}",
                key=f"indirect_data_{number}",
                address=target,
                rule=replace(cell.rule, default=0),
            )
